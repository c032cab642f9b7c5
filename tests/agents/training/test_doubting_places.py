"""What the pictures are labelled with agrees with the simulator's own truth and with the geometry."""

import math

import numpy as np
import pytest
from shapely import Point

from wrongturn_agents.models.doubt import FARTHEST
from wrongturn_agents.training.methods.places import NEAR, Places, draw_places
from wrongturn_networks import Town, load_town
from wrongturn_protocol import DIRECTIONS


@pytest.fixture(scope="module", params=["Town01", "junctions"])
def town(request: pytest.FixtureRequest) -> Town:
    return load_town(request.param)


@pytest.fixture(scope="module")
def places(town: Town) -> Places:
    return draw_places(town, np.random.default_rng(3), 4_000)


def _approach_ahead(town: Town, x: float, y: float, yaw: float) -> tuple[float, tuple[bool, ...]] | None:
    """Return the distance to the stop line ahead in a straight line, and the exits there; by shapely alone."""
    best = None
    for approach in town.approaches.values():
        sx, sy = approach.stop_line
        along = (sx - x) * math.cos(approach.heading) + (sy - y) * math.sin(approach.heading)
        aside = (sx - x) * math.sin(approach.heading) - (sy - y) * math.cos(approach.heading)
        turned = abs(math.remainder(yaw - approach.heading, math.tau))
        if 0 < along < NEAR and abs(aside) < 2.0 and turned < 0.5 and (best is None or along < best[0]):
            best = along, tuple(direction in approach.exits for direction in DIRECTIONS)
    return best


def test_distance_and_exits_are_those_of_the_approach_ahead(town: Town, places: Places) -> None:
    seen = 0
    for pose, distance, exits in zip(places.poses, places.distance, places.exits, strict=True):
        # Close before the line a lane is straight, so that the straight distance is that along the lane.
        if not 0.5 < distance < 12.0:
            continue
        found = _approach_ahead(town, *pose)
        assert found is not None
        assert found[0] == pytest.approx(distance, abs=0.75)
        assert tuple(exits > 0.5) == found[1]
        seen += 1
    assert seen > 300


def test_places_inside_lie_in_junctions_and_the_others_do_not(town: Town, places: Places) -> None:
    areas = [junction.area for junction in town.junctions.values()]
    # Cars astray may be beside the area that the paths run through, hence the buffer.
    for pose, distance in zip(places.poses, places.distance, strict=True):
        near = min(area.distance(Point(pose[:2])) for area in areas)
        if distance == 0.0:
            assert near < 4.5
        if 5.0 < distance < 15.0:
            assert near > 0.0


def test_exits_are_told_before_the_line_and_nowhere_else(places: Places) -> None:
    told = places.shown > 0.5
    assert np.array_equal(told, (places.distance > 0.0) & (places.distance <= NEAR))
    assert 0.3 < told.mean() < 0.8
    assert (places.exits[told].sum(1) >= 2).all()


def test_all_distances_are_drawn_and_the_same_by_the_same_generator(town: Town, places: Places) -> None:
    counts, _ = np.histogram(places.distance, [0.0, 1e-9, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, FARTHEST + 1])
    assert (counts > 100).all()
    again = draw_places(town, np.random.default_rng(3), 4_000)
    assert all(np.array_equal(a, b) for a, b in zip(places, again, strict=True))
