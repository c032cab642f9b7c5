"""Bends: the corners of the outer ring and nothing else."""

import math

import pytest
from shapely import LineString

from wrongturn_networks import Town, bends_of, load_town

CORNERS = {
    "Town01": [(0.0, 0.0), (394.4, 0.0), (394.4, 328.6), (0.0, 328.6)],
    "Town02": [(0.0, 0.0), (197.2, 0.0), (197.2, 197.2), (0.0, 197.2)],
    "junctions": [],
}


@pytest.mark.parametrize("name", sorted(CORNERS))
def test_both_ways_round_every_corner(name: str) -> None:
    town = load_town(name)
    found = []
    for lane in town.lanes.values():
        line = LineString(lane.centreline)
        for bend in bends_of(lane):
            middle = line.interpolate((bend.begin + bend.end) / 2)
            found.append(min(CORNERS[name], key=lambda corner: math.dist(corner, (middle.x, middle.y))))
            assert math.dist(found[-1], (middle.x, middle.y)) < 8
            assert bend.end - bend.begin == pytest.approx(10 * math.pi / 2, rel=0.35)  # a quarter of a circle
    assert sorted(found) == sorted(2 * CORNERS[name])


def test_a_lane_turns_within_its_bends_alone(town: Town) -> None:
    for lane in town.lanes.values():
        line = LineString(lane.centreline)
        ends = [0.0, *(place for bend in bends_of(lane) for place in bend), line.length]
        for begin, end in zip(ends[::2], ends[1::2], strict=True):
            a, b = line.interpolate(begin), line.interpolate(end)
            assert a.distance(b) == pytest.approx(end - begin, abs=0.01)
