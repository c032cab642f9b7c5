"""What is road and what is not, and where it bends: at the corners of the outer ring and nowhere else."""

import math

import numpy as np
import pytest
from shapely import LineString, Point, Polygon, box
from shapely.geometry.base import BaseGeometry

from wrongturn_networks import Approach, Exit, Town, bends_of
from wrongturn_protocol import JunctionType


def _whole_way(town: Town, approach: Approach, leaving: Exit) -> np.ndarray:
    before, after = town.lanes[approach.lane].centreline, town.lanes[leaving.lane].centreline
    return np.vstack([before[:-1], leaving.path, after[1:]])


def _ahead(approach: Approach, metres: float) -> Point:
    x, y = approach.stop_line
    return Point(x + metres * math.cos(approach.heading), y + metres * math.sin(approach.heading))


def _parts(area: BaseGeometry) -> list[Polygon]:
    return list(getattr(area, "geoms", [area]))


def test_a_path_leads_from_the_stop_line_to_the_exit_line(town: Town) -> None:
    for approach in town.approaches.values():
        for leaving in approach.exits.values():
            assert leaving.path[0] == pytest.approx(approach.stop_line)
            assert leaving.path[-1] == pytest.approx(town.lanes[leaving.lane].centreline[0])
            steps = np.linalg.norm(np.diff(leaving.path, axis=0), axis=1)
            assert steps.min() > 0.01
            # The pieces of a left turn join without a jump or a kink.
            headings = np.unwrap(np.arctan2(*np.diff(leaving.path, axis=0).T[::-1]))
            assert np.abs(np.diff(headings)).max(initial=0.0) < math.radians(12)


def test_a_car_on_any_permitted_way_is_on_the_road(town: Town) -> None:
    for approach in town.approaches.values():
        for leaving in approach.exits.values():
            swept = LineString(_whole_way(town, approach, leaving)).buffer(0.95, cap_style="flat")
            assert swept.difference(town.road).area < 1e-9, (approach.id, leaving.direction)
            wide = LineString(leaving.path).buffer(1.89, cap_style="flat")
            assert wide.difference(town.road).area < 0.01, (approach.id, leaving.direction)


def test_the_road_has_no_slivers_and_no_sidewalk(town: Town) -> None:
    assert town.sidewalks.is_valid
    assert town.sidewalks.intersection(town.road).area < 1e-6
    assert town.road.is_valid
    assert [part for part in _parts(town.road) if part.area < 1000] == []
    blocks = [Polygon(hole) for part in _parts(town.road) for hole in part.interiors]
    assert all(block.area > 300 for block in blocks)
    # Opening by a centimetre takes nothing away but corners: no hair-thin spikes or necks.
    opened = town.road.buffer(-0.05, join_style="mitre").buffer(0.05, join_style="mitre")
    assert town.road.difference(opened).area < 0.1


def test_past_the_kerb_where_the_arm_is_missing_is_sidewalk_and_no_road(town: Town) -> None:
    blind = [approach for approach in town.approaches.values() if approach.type is JunctionType.LEFT_RIGHT]
    assert blind
    for approach in blind:
        kerb = next(m for m in np.arange(0, 40, 0.05) if not town.road.covers(_ahead(approach, m)))
        assert 8 < kerb < 25
        assert town.sidewalks.covers(_ahead(approach, kerb + 0.1))
        assert not any(town.road.covers(_ahead(approach, kerb + m)) for m in np.arange(0, 12, 0.25))


def test_the_sidewalks_at_a_missing_arm_are_no_road(town: Town) -> None:
    """Corners count as junction in SUMO's shapes; here they are cut off."""
    for approach in town.approaches.values():
        side = {JunctionType.STRAIGHT_LEFT: -1, JunctionType.STRAIGHT_RIGHT: 1}.get(approach.type)
        if side is None:
            continue
        position = town.junctions[approach.junction].position
        left = (-math.sin(approach.heading), math.cos(approach.heading))
        across = [Point(position[0] + side * m * left[0], position[1] + side * m * left[1]) for m in (3.9, 4.1, 6.4, 8)]
        assert [town.road.covers(point) for point in across] == [True, False, False, False], approach.id


def test_a_junction_area_is_road_beyond_the_stop_lines(town: Town) -> None:
    for junction in town.junctions.values():
        assert junction.area.geom_type == "Polygon"
        assert junction.area.difference(town.road.buffer(1e-6)).area < 1e-6
        assert junction.area.covers(Point(junction.position))
        for name in junction.approaches:
            approach = town.approach(name)
            assert not junction.area.covers(_ahead(approach, -0.1))
            assert junction.area.covers(_ahead(approach, 0.1))


def test_the_road_is_as_wide_as_two_lanes(town: Town) -> None:
    for lane in town.lanes.values():
        middle = LineString(lane.centreline).interpolate(0.5, normalized=True)
        patch = box(middle.x - 0.5, middle.y - 0.5, middle.x + 0.5, middle.y + 0.5)
        assert town.road.covers(patch)
    assert town.road.area == pytest.approx(
        sum(lane.polygon.area for lane in town.lanes.values()) + sum(j.area.area for j in town.junctions.values()),
        rel=0.001,
    )


def test_a_lane_turns_within_its_bends_alone(town: Town) -> None:
    for lane in town.lanes.values():
        line = LineString(lane.centreline)
        ends = [0.0, *(place for bend in bends_of(lane) for place in bend), line.length]
        for begin, end in zip(ends[::2], ends[1::2], strict=True):
            a, b = line.interpolate(begin), line.interpolate(end)
            assert a.distance(b) == pytest.approx(end - begin, abs=0.01)
