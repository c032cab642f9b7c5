"""Where trials start: in their lane, able to stop, the same for the same seed."""

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from shapely import LineString, Polygon, affinity, box

from wrongturn_networks import (
    ApproachTooShortError,
    RouteNotAvailableError,
    Town,
    UnknownApproachError,
    draw_start,
    draw_trial,
    load_town,
    town_names,
)
from wrongturn_protocol import Command, Fault, FaultKind, Start, Trial, Weather

ARMS = [(name, approach) for name in town_names() for approach in load_town(name).approaches]
LENGTH, WIDTH = 4.6, 1.9
SEEDS = st.integers(0, 2**63 - 1)


def _body(town: Town, trial: Trial) -> Polygon:
    lane = LineString(town.lanes[town.approach(trial.approach).lane].centreline)
    along = lane.length - trial.start.distance
    here, on = lane.interpolate(along), lane.interpolate(along + 0.05)
    heading = math.atan2(on.y - here.y, on.x - here.x)
    body = affinity.rotate(box(-LENGTH / 2, -WIDTH / 2, LENGTH / 2, WIDTH / 2), heading + trial.start.yaw, (0, 0), True)
    left = trial.start.lateral
    return affinity.translate(body, here.x - left * math.sin(heading), here.y + left * math.cos(heading))


@given(st.sampled_from(ARMS), SEEDS)
def test_a_start_lies_in_its_lane(arm: tuple[str, str], seed: int) -> None:
    town = load_town(arm[0])
    trial = draw_trial(town, arm[1], FaultKind.NONE, seed)
    body = _body(town, trial)
    lane = town.lanes[town.approach(trial.approach).lane]
    assert body.difference(lane.polygon).area < 1e-6
    if lane.start_junction is not None:
        assert not body.intersects(town.junctions[lane.start_junction].area)


@given(st.floats(20.0, 500.0), SEEDS)
@example(20.0, 0)
def test_a_car_that_brakes_at_once_stops_before_it_is_engaged(lane_length: float, seed: int) -> None:
    start = draw_start(lane_length, seed)
    assert start.distance - start.speed**2 / (2 * 8.0) >= 15.0
    assert 17.0 - 1e-3 <= start.distance <= min(30.0, lane_length - 3.0 + 1e-3)
    assert 3.99 <= start.speed <= 9.0
    assert abs(start.lateral) <= 0.4
    assert abs(start.yaw) <= math.radians(6) + 1e-5
    if lane_length >= 33:
        assert start.distance >= 22


@pytest.mark.parametrize("lane_length", [0.0, 15.0, 18.9, 19.9])
def test_a_lane_too_short_is_refused(lane_length: float) -> None:
    with pytest.raises(ApproachTooShortError, match="choose another approach"):
        draw_start(lane_length, 1)


@given(SEEDS)
def test_the_start_is_the_seeds_alone(seed: int) -> None:
    town = load_town("Town01")
    drawn = draw_trial(town, "J3-S", FaultKind.INFEASIBLE, seed)
    assert drawn == draw_trial(town, "J3-S", FaultKind.INFEASIBLE, seed)
    for route in town.approach("J3-S").exits:
        other = draw_trial(town, "J3-S", FaultKind.OMISSION, seed, route=route, weather=Weather.WET_NOON)
        assert (other.start, other.route, other.weather) == (drawn.start, route, Weather.WET_NOON)


def test_the_draw_does_not_change_between_releases() -> None:
    start = draw_start(100.0, 17)
    assert start == Start(distance=26.176, speed=8.033, lateral=0.368, yaw=-0.04406)


def test_starts_and_routes_vary_from_seed_to_seed() -> None:
    town = load_town("Town01")
    trials = [draw_trial(town, "J3-S", FaultKind.NONE, seed) for seed in range(200)]
    assert len({trial.start for trial in trials}) == 200
    lefts = sum(trial.route is trials[0].route for trial in trials)
    assert 70 < lefts < 130


def test_a_trial_says_where_it_is() -> None:
    town = load_town("junctions")
    trial = draw_trial(town, "J1-S", Fault(kind=FaultKind.LATE, dose=4.5), 5, route=Command.LEFT)
    assert trial.id == "junctions.J1-S.late-4p5.s5"
    assert trial.twin().start == trial.start


def test_a_trial_needs_an_approach_and_an_exit() -> None:
    town = load_town("junctions")
    for route in (Command.STRAIGHT, Command.LANE_FOLLOW, Command.VOID):
        with pytest.raises(RouteNotAvailableError, match=r"^route: .*LEFT, RIGHT"):
            draw_trial(town, "J1-S", FaultKind.NONE, 1, route=route)
    with pytest.raises(UnknownApproachError, match="approach"):
        draw_trial(town, "J1-N", FaultKind.NONE, 1)


@pytest.mark.parametrize("seed", [-1, 2**63])
def test_a_seed_out_of_range_is_refused(seed: int) -> None:
    with pytest.raises(ValueError, match="seed"):
        draw_trial(load_town("junctions"), "J1-S", FaultKind.NONE, seed)
