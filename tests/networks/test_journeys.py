"""Journeys: of their task, by the shortest way, in CoRL 2017's lengths, and such that a car can drive them."""

from collections import Counter
from dataclasses import replace
from statistics import mean

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely import LineString, Point
from shapely.ops import substring

from wrongturn_networks import (
    ApproachTooShortError,
    NoJourneyError,
    Town,
    UnknownApproachError,
    draw_journey,
    load_town,
    town_names,
    ways_to,
)
from wrongturn_networks.journeys import MEAN_LENGTHS
from wrongturn_protocol import CORL_TASKS, Command, Fault, FaultKind, Journey, Start, Task, Traffic, Trial, Weather

TOWNS = st.sampled_from(town_names())
TASKS = st.sampled_from(CORL_TASKS)
SEEDS = st.integers(0, 2**63 - 1)


def _journey(trial: Trial) -> Journey:
    assert trial.journey is not None
    return trial.journey


def _driven(town: Town, trial: Trial) -> tuple[tuple[Command, ...], list[LineString]]:
    """The commands on the shortest way, and what is driven along lanes and through junctions, in turn."""
    journey = _journey(trial)
    start = town.approach(trial.approach).lane
    assert journey.goal is not None
    way = ways_to(town, journey.goal)[start]
    first = LineString(town.lanes[start].centreline)
    pieces = [substring(first, first.length - trial.start.distance, first.length)]
    for lane, command in zip(way.lanes[:-1], way.commands, strict=True):
        approach = town.approach_of_lane(lane)
        assert approach is not None
        pieces += [
            LineString(approach.exits[command].path),
            LineString(town.lanes[approach.exits[command].lane].centreline),
        ]
    pieces[-1] = substring(pieces[-1], 0, journey.goal_at)
    return way.commands, pieces


def _turned(line: LineString) -> float:
    """All the turning along a line, radians."""
    steps = np.diff(np.asarray(line.coords), axis=0)
    headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    return float(np.abs(np.diff(headings)).sum())


@given(TOWNS, TASKS, SEEDS)
def test_a_journey_can_be_driven(name: str, task: Task, seed: int) -> None:
    town = load_town(name)
    trial = draw_journey(town, task, seed)
    journey = _journey(trial)
    commands, pieces = _driven(town, trial)
    assert trial.route is commands[0]
    assert journey.length == pytest.approx(sum(piece.length for piece in pieces), abs=0.002)
    assert journey.time_limit == pytest.approx(journey.length * 0.36, abs=0.051)
    lane = town.lanes[town.approach(trial.approach).lane]
    assert (trial.start.speed, trial.start.lateral, trial.start.yaw) == (0, 0, 0)
    assert 17.0 - 1e-3 <= trial.start.distance <= lane.length - 3.0 + 1e-3
    assert journey.goal is not None
    assert 10.0 - 1e-3 <= journey.goal_at <= town.lanes[journey.goal].length - 5.0 + 1e-3
    goal = Point(pieces[-1].coords[-1])
    assert not any(junction.area.contains(goal) for junction in town.junctions.values())
    assert town.road.contains(goal)
    # Whoever drives by the shortest way comes to the goal's lane once, at the end: nobody begins past the goal.
    assert lane.id != journey.goal
    assert trial.junction_type is town.approach(trial.approach).type
    assert trial.id == f"{name}.{task}.{trial.approach}.s{seed}"
    assert (trial.fault, trial.traffic) == (Fault(kind=FaultKind.NONE), Traffic())
    assert Trial.model_validate_json(trial.model_dump_json()) == trial == draw_journey(town, task, seed)


@given(TOWNS, SEEDS)
def test_straight_is_straight(name: str, seed: int) -> None:
    commands, pieces = _driven(load_town(name), draw_journey(load_town(name), Task.STRAIGHT, seed))
    assert set(commands) == {Command.STRAIGHT}
    assert sum(_turned(piece) for piece in pieces) < 0.35
    assert LineString([pieces[0].coords[0], pieces[-1].coords[-1]]).length > 0.97 * sum(p.length for p in pieces)


@given(TOWNS, SEEDS)
def test_one_turn_is_one(name: str, seed: int) -> None:
    commands, pieces = _driven(load_town(name), draw_journey(load_town(name), Task.ONE_TURN, seed))
    assert sum(command is not Command.STRAIGHT for command in commands) == 1
    assert max(_turned(piece) for piece in pieces[::2]) < 0.05  # no bend of a street beside it


@pytest.mark.parametrize(("where", "metres"), MEAN_LENGTHS.items())
def test_lengths_are_corls_on_average(where: tuple[str, Task], metres: float) -> None:
    town, task = load_town(where[0]), where[1]
    journeys = [draw_journey(town, task, seed) for seed in range(200)]
    lengths = [_journey(trial).length for trial in journeys]
    assert mean(lengths) == pytest.approx(metres, rel=0.05)
    assert metres * 0.499 <= min(lengths) <= max(lengths) <= metres * 1.501
    # All over the town: no approach takes more than four times its share.
    begins = Counter(trial.approach for trial in journeys)
    assert max(begins.values()) <= 4 * 200 / len(begins)


def test_a_journey_is_what_it_was() -> None:
    trial = draw_journey(load_town("Town01"), Task.NAVIGATION, 17, weather=Weather.WET_NOON)
    assert trial.id == "Town01.navigation.J2-W.s17"
    assert trial.start == Start(distance=181.66, speed=0, lateral=0, yaw=0)
    assert trial.weather is Weather.WET_NOON
    assert _journey(trial) == Journey(
        task=Task.NAVIGATION, goal="J8-J7_1", goal_at=15.512, length=675.342, time_limit=243.1
    )


def test_other_road_users_change_no_route() -> None:
    town, traffic = load_town("Town01"), Traffic(vehicles=20, pedestrians=50)
    for seed in range(20):
        alone = draw_journey(town, Task.NAVIGATION, seed)
        among = draw_journey(town, Task.NAVIGATION_DYNAMIC, seed, traffic=traffic)
        assert (alone.start, alone.approach, alone.route) == (among.start, among.approach, among.route)
        assert among.traffic == traffic
        assert alone.id != among.id


@pytest.mark.parametrize("task", CORL_TASKS)
def test_from_an_approach_of_ones_choice(town: Town, task: Task) -> None:
    refused = 0
    for approach in town.approaches:
        try:
            trial = draw_journey(town, task, 3, approach=approach)
        except NoJourneyError as error:
            assert f"task: {town.name} has no journey {task} that begins at {approach}" in str(error)  # noqa: PT017
            refused += 1
        else:
            assert trial.approach == approach
            assert draw_journey(town, task, 4, approach=approach).start != trial.start
    assert refused < len(town.approaches) / 2


def test_what_cannot_be_drawn() -> None:
    town = load_town("Town01")
    with pytest.raises(NoJourneyError, match=r"^task: cruise has no goal; choose one of straight, one_turn"):
        draw_journey(town, Task.CRUISE, 1)
    with pytest.raises(UnknownApproachError, match=r"^approach: 'J99-N' is not known"):
        draw_journey(town, Task.STRAIGHT, 1, approach="J99-N")
    with pytest.raises(NoJourneyError, match="begins at J1-N"):
        draw_journey(town, Task.STRAIGHT, 1, approach="J1-N")
    approach = town.approach("J2-W")
    short = replace(town, lanes={**town.lanes, approach.lane: replace(town.lanes[approach.lane], length=19.9)})
    with pytest.raises(ApproachTooShortError, match=r"^approach: its lane is 19\.9 m long and a start needs 20 m"):
        draw_journey(short, Task.NAVIGATION, 1, approach="J2-W")
