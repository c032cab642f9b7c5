"""Junction maps: their frame, and their shares."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wrongturn_networks import load_suite, load_town
from wrongturn_protocol import Command, FaultKind, Flag, JunctionType, Outcome, Safety, Verdict
from wrongturn_protocol.junction_frame import Frame
from wrongturn_service.storage.finished import FinishedEpisode
from wrongturn_service.web import junction_map
from wrongturn_service.web.junction_map import frame_of, on_map

METRES = st.floats(-500, 500)
ANGLES = st.floats(-math.pi, math.pi)


def to_micrometres(points):
    """Shapely warns of coordinates such as 1e-262, which no car is at."""
    return np.round(np.array(points), 6)


POINTS = st.lists(st.tuples(st.floats(-60, 60), st.floats(-60, 60)), min_size=1, max_size=20).map(to_micrometres)
OUTCOMES = st.lists(
    st.builds(
        Outcome,
        verdict=st.sampled_from(Verdict),
        exit=st.sampled_from([None, Command.LEFT, Command.RIGHT, Command.STRAIGHT]),
        flags=st.sampled_from([(), (Flag.OPPOSED_LANE,)]),
        time=st.just(1.0),
        max_deceleration=st.just(0.0),
    ),
    max_size=60,
)


@given(POINTS, METRES, METRES, ANGLES, METRES, METRES, ANGLES)
def test_a_path_that_moves_with_its_approach_is_drawn_the_same(points, x, y, heading, by_x, by_y, turn):
    cos, sin = math.cos(turn), math.sin(turn)
    rotation = np.array([[cos, -sin], [sin, cos]])
    moved = points @ rotation.T + [by_x, by_y]
    origin = rotation @ np.array([x, y]) + [by_x, by_y]
    drawn = Frame((x, y), heading).turned(points)
    assert np.allclose(Frame((origin[0], origin[1]), heading + turn).turned(moved), drawn, atol=1e-6)


@given(METRES, METRES, ANGLES)
def test_the_car_drives_in_from_below_and_left_is_left(x, y, heading):
    ahead, left = np.array([math.cos(heading), math.sin(heading)]), np.array([-math.sin(heading), math.cos(heading)])
    node, frame = np.array([x, y]), Frame((x, y), heading)
    points = np.array([node - 30 * ahead, node + 10 * left])
    assert np.allclose(frame.turned(points), [[0, -30], [-10, 0]], atol=1e-6)
    assert np.allclose(on_map(frame, points), [[0, 30], [-10, 0]], atol=1e-6)


def test_all_approaches_of_a_type_have_the_street_in_the_same_place():
    town = load_town("Town01")
    for approach in town.approaches.values():
        drawn = on_map(frame_of(town, approach.id), np.array([approach.stop_line]))
        assert drawn[0, 0] == pytest.approx(2, abs=0.1)  # half a lane to the right of the street's centre line
        assert drawn[0, 1] > 5
        for direction, way_out in approach.exits.items():
            x, y = on_map(frame_of(town, approach.id), way_out.path[-1:])[0]
            if direction is Command.STRAIGHT:
                assert (x, y < -5) == (pytest.approx(2, abs=0.1), True)
            else:
                assert (x < 0) == (direction is Command.LEFT)
                assert y == pytest.approx(-2 if direction is Command.LEFT else 2, abs=0.1)


def _map(outcomes, paths):
    trials = [trial for trial in load_suite("smoke@3").trials if trial.junction_type is JunctionType.LEFT_RIGHT]
    trial = trials[0]
    driven = [
        (FinishedEpisode(f"ep_{number}", "ev_1", trial, outcome), path)
        for number, (outcome, path) in enumerate(zip(outcomes, paths, strict=True))
    ]
    return junction_map.junction_map(trial.junction_type, FaultKind.INFEASIBLE, [(trial.town, trial.approach)], driven)


@given(OUTCOMES)
def test_a_map_counts_every_trial_also_those_without_a_path(outcomes):
    drawn = _map(outcomes, [None if number % 2 else np.zeros((3, 2)) for number in range(len(outcomes))])
    assert sum(share.trials for share in drawn.shares) == drawn.trials == len(outcomes)
    assert len(drawn.paths) == (len(outcomes) + 1) // 2
    assert drawn.unsafe == sum(share.trials for share in drawn.shares if share.side is Safety.UNSAFE)
    assert [direction for direction, _ in drawn.arms] == ["left", "right"]


def test_a_mark_stays_on_the_map_and_unsafe_paths_lie_on_top():
    outcomes = [Outcome(verdict=v, time=1, max_deceleration=0) for v in (Verdict.OFF_ROAD, Verdict.TIMEOUT)]
    far = np.array([[0.0, 0.0], [9000.0, -9000.0]])
    drawn = _map([*outcomes, outcomes[1]], [far, far, np.empty((0, 2))])
    assert [path.side for path in drawn.paths] == [Safety.NEITHER, Safety.UNSAFE]
    for path in drawn.paths:
        assert junction_map.LEFT < path.end[0] < junction_map.RIGHT
        assert junction_map.TOP < path.end[1] < junction_map.BOTTOM
