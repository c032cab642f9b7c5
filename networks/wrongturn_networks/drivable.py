"""The area where a car may be: the road and each junction's area, from a net's lanes and shapes.

The road's edge is a kerb. Beyond it lies sidewalk or ground; kerbs are not objects of the scenery.
"""

from collections.abc import Iterable

from shapely import LineString, Polygon, unary_union
from shapely.geometry.base import BaseGeometry

from wrongturn_networks.lanes import Line
from wrongturn_networks.netfile import Net, NetJunction

PATH_HALF_WIDTH = 1.9
"""Road reaches this far to either side of a permitted path through a junction, metres."""

_SEAM = 0.02
"""Narrower gaps between neighbouring areas are closed, metres: net files are rounded to a centimetre."""


def lane_polygon(centreline: Line, width: float) -> Polygon:
    """Return a lane's area: its centre line widened, with square ends."""
    return LineString(centreline).buffer(width / 2, cap_style="flat", join_style="mitre")


def walking_areas(net: Net) -> BaseGeometry:
    """Return the parts of junctions that belong to pedestrians."""
    return unary_union([outline(lane.shape) for lane in net.lanes.values() if lane.function == "walkingarea"])


def outline(shape: Line) -> BaseGeometry:
    """Return the area of an outline (n, 2), also of one that crosses itself; nothing for fewer than three points."""
    return Polygon(shape).buffer(0) if len(shape) > 2 else Polygon()


def sidewalks(net: Net) -> BaseGeometry:
    """Return all areas for pedestrians: sidewalks along roads, and walking areas at junctions."""
    along = [
        lane_polygon(lane.shape, lane.width)
        for lane in net.lanes.values()
        if lane.function == "normal" and lane.walk and not lane.cars
    ]
    return unary_union([*along, walking_areas(net)])


def road(net: Net, junctions: Iterable[NetJunction]) -> BaseGeometry:
    """Return the road: car lanes, junctions without walking areas, and the permitted paths through them."""
    lanes = [
        lane_polygon(lane.shape, lane.width) for lane in net.lanes.values() if lane.function == "normal" and lane.cars
    ]
    paths = [
        LineString(net.lanes[internal].shape).buffer(PATH_HALF_WIDTH, cap_style="flat", join_style="mitre")
        for connection in net.connections
        for internal in connection.via
    ]
    walked = walking_areas(net)
    shapes = [outline(junction.shape).difference(walked) for junction in junctions]
    return unary_union([*lanes, *paths, *shapes]).buffer(_SEAM, join_style="mitre").buffer(-_SEAM, join_style="mitre")


def junction_area(junction: NetJunction, town_road: BaseGeometry) -> BaseGeometry:
    """Return the part of the junction's shape that is road."""
    area = outline(junction.shape).intersection(town_road)
    parts = [part for part in getattr(area, "geoms", [area]) if part.area > 0.1]
    return unary_union(parts)
