"""Shortest ways: against a reckoning of their own, over the whole of each town."""

import math

import numpy as np
import pytest

from wrongturn_networks import Town, UnknownLaneError, exits_towards, load_town, ways_to
from wrongturn_protocol import Command


def _length(line: np.ndarray) -> float:
    return math.fsum(math.dist(a, b) for a, b in zip(line[:-1].tolist(), line[1:].tolist(), strict=True))


def _all_metres(town: Town) -> tuple[list[str], np.ndarray]:
    """From begin to begin of any two lanes, by Floyd and Warshall; the diagonal is the way round."""
    lanes = list(town.lanes)
    row = {lane: number for number, lane in enumerate(lanes)}
    metres = np.full((len(lanes), len(lanes)), np.inf)
    for approach in town.approaches.values():
        for exit_ in approach.exits.values():
            there = _length(town.lanes[approach.lane].centreline) + _length(exit_.path)
            metres[row[approach.lane], row[exit_.lane]] = there
    for k in range(len(lanes)):
        metres = np.minimum(metres, metres[:, k : k + 1] + metres[k : k + 1])
    return lanes, metres


def test_ways_are_the_shortest(town: Town) -> None:
    lanes, metres = _all_metres(town)
    for column, goal in enumerate(lanes):
        ways = ways_to(town, goal)
        for row, lane in enumerate(lanes):
            if math.isinf(metres[row, column]):
                assert lane not in ways
            else:
                assert ways[lane].metres == pytest.approx(metres[row, column], abs=1e-6)


def test_a_way_can_be_driven_and_has_its_length(town: Town) -> None:
    for goal in town.lanes:
        for lane, way in ways_to(town, goal).items():
            assert (way.lanes[0], way.lanes[-1]) == (lane, goal)
            driven = 0.0
            for here, command, onward in zip(way.lanes[:-1], way.commands, way.lanes[1:], strict=True):
                approach = town.approach_of_lane(here)
                assert approach is not None
                assert approach.exits[command].lane == onward
                driven += town.lanes[here].length + _length(approach.exits[command].path)
            assert way.metres == pytest.approx(driven, abs=1e-6)


def test_the_exit_towards_a_goal_is_the_first_of_the_way(town: Town) -> None:
    for goal in town.lanes:
        ways = ways_to(town, goal)
        first = {lane: ways[lane].commands[0] if lane in ways else None for lane in town.lanes}
        assert exits_towards(town, goal) == first


def test_no_way_leads_out_of_a_dead_end() -> None:
    exits = exits_towards(load_town("junctions"), "J2-N_1")
    assert exits["J1-W_1"] is None  # its end
    assert exits["J2-N_1"] is None  # no way back round to the goal
    assert exits["J2-J1_1"] is None  # away from it, and nobody turns round
    assert exits["W-J1_1"] is Command.STRAIGHT
    assert exits["J1-J2_1"] is Command.LEFT


def test_an_unknown_lane_names_the_known(town: Town) -> None:
    for find in (ways_to, exits_towards):
        with pytest.raises(UnknownLaneError, match=r"^lane: 'J0-J9_7' is not known; there are: .*J1-J2_1"):
            find(town, "J0-J9_7")


def test_ways_cannot_be_changed(town: Town) -> None:
    goal = next(iter(town.lanes))
    with pytest.raises(TypeError):
        exits_towards(town, goal)[goal] = None  # type: ignore[index]
    with pytest.raises(TypeError):
        del ways_to(town, goal)[goal]  # type: ignore[attr-defined]
