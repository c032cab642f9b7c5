"""Shortest ways through a town, in metres along the lanes and the paths through its junctions."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from shapely import LineString

from wrongturn_networks.errors import UnknownLaneError
from wrongturn_networks.junctions import Exit
from wrongturn_networks.per_net import once_per_net
from wrongturn_networks.town import Town
from wrongturn_protocol import Command


class Way(NamedTuple):
    """The shortest way from the start of a lane to the start of another."""

    metres: float
    commands: tuple[Command, ...]
    """Direction at each junction on the way, beginning with the one at the first lane's end."""
    lanes: tuple[str, ...]
    """Lanes of the way, the first and the last included."""


@once_per_net(256)
def ways_to(town: Town, lane_id: str) -> Mapping[str, Way]:
    """Return the shortest ways to a lane, by the id of the lane that they start from.

    From the lane itself it is the shortest way round to its start, which a car needs that went past its goal. Cars turn
    round only by driving along streets. Lanes from which no way leads there are left out. Raises UnknownLaneError.
    """
    if lane_id not in town.lanes:
        raise UnknownLaneError(lane_id, town.lanes)
    # Imported here: it takes a fifth of a second, and reading a suite does not need it.
    from networkx import DiGraph, single_source_dijkstra_path_length  # noqa: PLC0415

    onward = _onward(town)
    graph = DiGraph()
    graph.add_nodes_from(town.lanes)
    # Searching backwards from the goal finds the ways from all lanes at once.
    graph.add_weighted_edges_from((b, a, metres) for a, exits in onward.items() for b, (metres, _) in exits.items())
    left: dict[str, float] = single_source_dijkstra_path_length(graph, lane_id)

    def best(lane: str) -> tuple[float, str, Command] | None:
        # Of equally long ways it takes the first in the order left, right, straight.
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


@once_per_net(256)
def exits_towards(town: Town, lane_id: str) -> Mapping[str, Command | None]:
    """Return, for each lane of the town, the exit at its end that lies on the shortest way to a lane.

    It is None where no way leads there, or no junction lies at the lane's end. Raises UnknownLaneError.
    """
    ways = ways_to(town, lane_id)
    return MappingProxyType({lane: ways[lane].commands[0] if lane in ways else None for lane in town.lanes})


@once_per_net(16)
def _onward(town: Town) -> dict[str, dict[str, tuple[float, Command]]]:
    """Return, for each lane, metres and direction from its start to the start of each lane after it."""
    found: dict[str, dict[str, tuple[float, Command]]] = {lane: {} for lane in town.lanes}
    for approach in town.approaches.values():
        length = town.lanes[approach.lane].length
        found[approach.lane] = {
            exit_.lane: (length + path_length(exit_), exit_.direction) for exit_ in approach.exits.values()
        }
    return found


def path_length(exit_: Exit) -> float:
    """Return the length of an exit's path from the stop line to the exit line, metres."""
    return float(LineString(exit_.path).length)
