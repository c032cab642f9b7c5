"""Where a car may be: the road and each junction's area, from a net's lanes and shapes.

Kerbs stand implicitly along the road's edge: what lies beyond is sidewalk or ground, and no object of the scenery.
"""

from collections.abc import Iterable

from shapely import LineString, Polygon, unary_union
from shapely.geometry.base import BaseGeometry

from wrongturn_networks.lanes import Line
from wrongturn_networks.netfile import Net, NetJunction

PATH_HALF_WIDTH = 1.9
"""A permitted path through a junction is road this far to either side, metres."""

_SEAM = 0.02
"""Net files are rounded to a centimetre: narrower gaps between neighbouring areas are no gaps, metres."""


def lane_polygon(centreline: Line, width: float) -> Polygon:
    """A lane's area: its centre line widened, its ends cut square."""
    return LineString(centreline).buffer(width / 2, cap_style="flat", join_style="mitre")


def walking_areas(net: Net) -> BaseGeometry:
    """The parts of junctions' shapes that belong to pedestrians."""
    return unary_union([Polygon(lane.shape).buffer(0) for lane in net.lanes.values() if lane.function == "walkingarea"])


def sidewalks(net: Net) -> BaseGeometry:
    """Everything that is for pedestrians: sidewalks along the roads and walking areas at junctions."""
    along = [
        lane_polygon(lane.shape, lane.width)
        for lane in net.lanes.values()
        if lane.function == "normal" and not lane.cars
    ]
    return unary_union([*along, walking_areas(net)])


def road(net: Net, junctions: Iterable[NetJunction]) -> BaseGeometry:
    """Lanes for cars, junctions without their walking areas, and the permitted paths through them."""
    lanes = [
        lane_polygon(lane.shape, lane.width) for lane in net.lanes.values() if lane.function == "normal" and lane.cars
    ]
    paths = [
        LineString(net.lanes[internal].shape).buffer(PATH_HALF_WIDTH, cap_style="flat", join_style="mitre")
        for connection in net.connections
        for internal in connection.via
    ]
    walked = walking_areas(net)
    shapes = [Polygon(junction.shape).buffer(0).difference(walked) for junction in junctions]
    return unary_union([*lanes, *paths, *shapes]).buffer(_SEAM, join_style="mitre").buffer(-_SEAM, join_style="mitre")


def junction_area(junction: NetJunction, town_road: BaseGeometry) -> BaseGeometry:
    """The junction's shape cut with the road."""
    area = Polygon(junction.shape).buffer(0).intersection(town_road)
    parts = [part for part in getattr(area, "geoms", [area]) if part.area > 0.1]
    return unary_union(parts)
