"""Shortest ways through a town, in metres along the lanes and the paths through its junctions."""

from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import NamedTuple

from shapely import LineString

from wrongturn_networks.errors import UnknownLaneError
from wrongturn_networks.junctions import Exit
from wrongturn_networks.town import Town
from wrongturn_protocol import Command


class Way(NamedTuple):
    """The shortest way from the begin of a lane to the begin of another."""

    metres: float
    commands: tuple[Command, ...]
    """The direction at each junction on it; the first is that of the lane's own junction."""
    lanes: tuple[str, ...]
    """Those that it leads along, the first and the last included."""


@lru_cache(maxsize=256)
def ways_to(town: Town, lane_id: str) -> Mapping[str, Way]:
    """The shortest way to a lane from each lane from which there is one, by the lane's id.

    From the lane itself it is the shortest way back round to its begin: what a car needs that has run past its goal.
    There is no turning round but by the streets.

    Args:
        town: its car lanes and the exits of its approaches.
        lane_id: where to.

    Raises:
        UnknownLaneError: the town has no such lane.
    """
    if lane_id not in town.lanes:
        raise UnknownLaneError(lane_id, town.lanes)
    # Here, since a fifth of a second is much for all who only read a suite.
    from networkx import DiGraph, single_source_dijkstra_path_length  # noqa: PLC0415

    onward = _onward(town)
    graph = DiGraph()
    graph.add_nodes_from(town.lanes)
    # From the goal backward, so that one search finds the ways from everywhere.
    graph.add_weighted_edges_from((b, a, metres) for a, exits in onward.items() for b, (metres, _) in exits.items())
    left: dict[str, float] = single_source_dijkstra_path_length(graph, lane_id)

    def best(lane: str) -> tuple[float, str, Command] | None:
        # Of two that are equally long the first in the order left, right, straight.
        there = [(metres + left[to], to, turn) for to, (metres, turn) in onward[lane].items() if to in left]
        return min(there, key=lambda option: option[0], default=None)

    steps = {lane: step for lane in town.lanes if (step := best(lane)) is not None}
    ways = {}
    for lane, (metres, _, _) in steps.items():
        commands: list[Command] = []
        lanes = [lane]
        while not commands or lanes[-1] != lane_id:
            _, to, turn = steps[lanes[-1]]
            commands.append(turn)
            lanes.append(to)
        ways[lane] = Way(metres, tuple(commands), tuple(lanes))
    return MappingProxyType(ways)


def exits_towards(town: Town, lane_id: str) -> Mapping[str, Command | None]:
    """At the end of each lane of the town: the exit on the shortest way to a lane.

    For the lane itself it is the exit of the way back round to it. None where no way leads there, or no junction is
    at the lane's end.

    Raises:
        UnknownLaneError: the town has no such lane.
    """
    return _exits_towards(town, lane_id)


@lru_cache(maxsize=256)
def _exits_towards(town: Town, lane_id: str) -> Mapping[str, Command | None]:
    ways = ways_to(town, lane_id)
    return MappingProxyType({lane: ways[lane].commands[0] if lane in ways else None for lane in town.lanes})


@lru_cache(maxsize=16)
def _onward(town: Town) -> dict[str, dict[str, tuple[float, Command]]]:
    """From the begin of each lane to those of the lanes after it: metres and direction."""
    found: dict[str, dict[str, tuple[float, Command]]] = {lane: {} for lane in town.lanes}
    for approach in town.approaches.values():
        length = town.lanes[approach.lane].length
        found[approach.lane] = {
            exit_.lane: (length + path_length(exit_), exit_.direction) for exit_ in approach.exits.values()
        }
    return found


def path_length(exit_: Exit) -> float:
    """From the stop line to the exit line, metres."""
    return float(LineString(exit_.path).length)
