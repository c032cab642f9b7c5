"""Cruises: where training begins, in the shares asked for, each approach as often as any other."""

import math
from collections import Counter
from functools import cache
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from shapely import LineString

from wrongturn_networks import CruiseError, Town, bends_of, draw_cruise, load_town
from wrongturn_protocol import FaultKind, Task, Traffic, Trial, Weather

MANY = 6000


@cache
def _drawn(town: Town, number: int = MANY, **how: Any) -> list[Trial]:
    return _drawn_anew(town, number, **how)


def _drawn_anew(town: Town, number: int, **how: Any) -> list[Trial]:
    random = np.random.default_rng(5)
    return [draw_cruise(town, random, **how) for _ in range(number)]


def test_a_cruise_is_a_sound_trial(town: Town) -> None:
    for trial in _drawn(town, 500, weather=Weather.WET_NOON, time_limit=90.0):
        assert Trial.model_validate(trial.model_dump()) == trial
        assert Trial.model_validate_json(trial.model_dump_json()) == trial
        assert trial.id == f"{town.name}.cruise.{trial.approach}.s{trial.seed}"
        approach = town.approach(trial.approach)
        assert trial.junction_type is approach.type
        assert trial.route in approach.exits
        assert 5.0 <= trial.start.distance <= town.lanes[approach.lane].length - 3.0 + 1e-3
        assert (trial.fault.kind, trial.weather, trial.traffic) == (FaultKind.NONE, Weather.WET_NOON, Traffic())
        assert trial.journey is not None
        assert (trial.journey.task, trial.journey.goal, trial.journey.time_limit) == (Task.CRUISE, None, 90.0)


def test_the_same_generator_gives_the_same_cruises(town: Town) -> None:
    trials = _drawn(town, 50)
    assert trials == _drawn_anew(town, 50) == _drawn_anew(town, 50, inside_junctions=0.0)
    assert len({trial.seed for trial in trials}) == 50
    assert len({trial.start for trial in trials}) == 50


def test_near_junctions_every_approach_comes_as_often(town: Town) -> None:
    trials = _drawn(town, near_junctions=1.0, near_bends=0.0)
    assert max(trial.start.distance for trial in trials) <= 35.0
    times = Counter(trial.approach for trial in trials)
    assert set(times) == set(town.approaches)
    expected = MANY / len(times)
    assert all(abs(count - expected) < 5 * math.sqrt(expected) for count in times.values())
    types = Counter(trial.junction_type for trial in trials)
    for kind, number in town.summary().approaches.items():
        assert types[kind] == pytest.approx(expected * number, rel=0.1)


@pytest.mark.parametrize("far", [False, True])
def test_every_exit_comes_as_often(town: Town, far: bool) -> None:
    trials = [trial for trial in _drawn(town) if (trial.start.distance > 20) is far]
    for kind in {trial.junction_type for trial in trials}:
        routes = Counter(trial.route for trial in trials if trial.junction_type is kind)
        assert set(routes) == kind.exits
        expected = sum(routes.values()) / len(routes)
        assert all(abs(count - expected) < 5 * math.sqrt(expected) for count in routes.values())


@pytest.mark.parametrize("name", ["Town01", "Town02"])
def test_near_bends_a_bend_is_ahead(name: str) -> None:
    town = load_town(name)
    seen = set()
    for trial in _drawn(town, 2000, near_junctions=0.0, near_bends=1.0):
        lane = town.lanes[town.approach(trial.approach).lane]
        at = lane.length - trial.start.distance
        ahead = [bend for bend in bends_of(lane) if 5.0 - 1e-3 <= bend.begin - at <= 25.0 + 1e-3]
        assert len(ahead) == 1
        seen.add((lane.id, ahead[0].begin))
    assert len(seen) == 8  # both ways round each of the ring's corners
    assert len(_drawn(load_town("junctions"), 100, near_junctions=0.0, near_bends=1.0)) == 100  # it has none


def test_elsewhere_every_metre_comes_as_often(town: Town) -> None:
    trials = _drawn(town, near_junctions=0.0, near_bends=0.0)
    room = {a.id: town.lanes[a.lane].length - 8.0 for a in town.approaches.values()}
    times = Counter(trial.approach for trial in trials)
    for approach, metres in room.items():
        expected = MANY * metres / sum(room.values())
        assert abs(times[approach] - expected) < 5 * math.sqrt(expected)
    shares = [(trial.start.distance - 5.0) / room[trial.approach] for trial in trials]
    assert np.histogram(shares, 10, (0, 1))[0] == pytest.approx(MANY / 10, rel=0.2)


def test_shares_are_those_asked_for() -> None:
    town = load_town("Town01")
    near = [trial for trial in _drawn(town) if trial.start.distance <= 35.0]
    room = {a.id: town.lanes[a.lane].length for a in town.approaches.values()}
    by_chance = sum(min(30.0, metres - 8.0) for metres in room.values()) / sum(m - 8.0 for m in room.values())
    # Of those near bends none is near a junction in this town.
    assert len(near) / MANY == pytest.approx(0.4 + 0.35 * by_chance, abs=0.03)


def test_starts_inside_junctions_lie_on_the_routes_path() -> None:
    town = load_town("Town01")
    drawn = _drawn(town, near_junctions=0.3, near_bends=0.2, inside_junctions=0.2)
    inside = [trial for trial in drawn if trial.start.distance < 0.0]
    assert len(inside) / MANY == pytest.approx(0.2, abs=0.02)
    exits = Counter((trial.approach, trial.route) for trial in inside)
    assert set(exits) == {(name, route) for name, approach in town.approaches.items() for route in approach.exits}
    shares = []
    for trial in inside:
        path = LineString(town.approach(trial.approach).exits[trial.route].path)
        assert Trial.model_validate_json(trial.model_dump_json()) == trial
        assert 0.0 <= trial.start.speed <= 5.0
        shares.append(-trial.start.distance / path.length)
    assert np.histogram(shares, 5, (0, 1))[0] == pytest.approx(len(inside) / 5, rel=0.2)
    assert max(trial.start.speed for trial in drawn if trial.start.distance > 0.0) > 8.5


def test_only_a_cruise_may_start_inside_a_junction() -> None:
    town = load_town("Town01")
    trial = _drawn(town, 1, near_junctions=0.0, near_bends=0.0, inside_junctions=1.0)[0]
    with pytest.raises(ValidationError, match=r"start\.distance: .*only a cruise"):
        Trial.model_validate(trial.model_dump() | {"journey": None})


def test_offsets_headings_and_speeds() -> None:
    starts = [trial.start for trial in _drawn(load_town("Town01"))]
    assert np.std([start.lateral for start in starts]) == pytest.approx(0.4, rel=0.05)
    assert np.std([start.yaw for start in starts]) == pytest.approx(0.06, rel=0.05)
    assert max(abs(start.lateral) for start in starts) == 1.0  # the body stays in its lane
    assert max(abs(start.yaw) for start in starts) == pytest.approx(0.15)
    speeds = [start.speed for start in starts]
    assert (min(speeds), max(speeds)) == pytest.approx((0.0, 9.0), abs=0.05)
    assert np.mean(speeds) == pytest.approx(4.5, abs=0.15)
    still = [trial.start for trial in _drawn(load_town("Town01"), 20, lateral=0, yaw=0, speed=(0, 0))]
    assert {(start.lateral, start.yaw, start.speed) for start in still} == {(0, 0, 0)}


@pytest.mark.parametrize(
    ("how", "field"),
    [
        ({"near_junctions": 0.8}, "near_junctions, near_bends, inside_junctions"),
        ({"near_bends": -0.1}, "near_junctions, near_bends, inside_junctions"),
        ({"near_junctions": math.nan}, "near_junctions, near_bends, inside_junctions"),
        ({"inside_junctions": math.nan}, "near_junctions, near_bends, inside_junctions"),
        ({"inside_junctions": 0.4}, "near_junctions, near_bends, inside_junctions"),
        ({"speed": (5.0, 2.0)}, "speed"),
        ({"speed": (0.0, 23.0)}, "speed"),
        ({"window": (0.0, 20.0)}, "window"),
        ({"window": (20.0, 10.0)}, "window"),
        ({"window": (10.0, 61.0)}, "window"),
        ({"window": (math.nan, 20.0)}, "window"),
        ({"lateral": 3.0}, "lateral, yaw"),
        ({"time_limit": 0.0}, "time_limit"),
        ({"time_limit": math.nan}, "time_limit"),
        ({"yaw": -0.1}, "lateral, yaw"),
        ({"alone": 1.1}, "alone"),
        ({"least_traffic": Traffic(vehicles=1)}, "least_traffic"),
    ],
)
def test_what_makes_no_sense_is_named(how: dict[str, Any], field: str) -> None:
    with pytest.raises(CruiseError, match=f"^{field}: .*; give|^{field}: .* give"):
        _drawn(load_town("Town01"), 1, **how)


def test_each_cruise_draws_its_own_window() -> None:
    windows = [trial.window for trial in _drawn(load_town("Town01"), 2000)]
    assert all(window is not None and 10.0 <= window <= 20.0 for window in windows)
    assert np.histogram(windows, 5, (10, 20))[0] == pytest.approx(400, rel=0.2)
    assert {trial.window for trial in _drawn(load_town("Town01"), 20, window=(12.0, 12.0))} == {12.0}


def test_the_window_shifts_no_other_draw() -> None:
    nominal = _drawn(load_town("Town01"), 200, window=None)
    assert all(trial.window is None for trial in nominal)
    drawn = _drawn(load_town("Town01"), 200)
    assert [trial.model_copy(update={"window": None}) for trial in drawn] == nominal


def test_cruises_beside_others_begin_as_those_alone(town: Town) -> None:
    most, least = Traffic(vehicles=9, pedestrians=6), Traffic(vehicles=3, pedestrians=6)
    plain = _drawn(town, 400)
    beside = _drawn(town, 400, traffic=most, alone=0.25, least_traffic=least)
    assert [trial.model_copy(update={"traffic": Traffic()}) for trial in beside] == plain
    numbers = Counter(trial.traffic.vehicles for trial in beside)
    assert set(numbers) == {0, *range(3, 10)}
    assert 60 < numbers[0] < 140
    assert {trial.traffic.pedestrians for trial in beside if trial.traffic.vehicles} == {6}
    assert {trial.traffic for trial in _drawn(town, 20, traffic=most)} == {most}
