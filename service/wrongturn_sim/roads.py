"""A town's lanes and exits as the arrays that ``guide.py`` reads."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wrongturn_judge.compiling import words
from wrongturn_networks import Approach, Town
from wrongturn_networks.per_net import once_per_net
from wrongturn_protocol import DIRECTIONS, Command
from wrongturn_protocol.observations import PATH_POINTS
from wrongturn_sim.guide import GATE, LEG
from wrongturn_sim.polyline import Points, Polyline, fill


@dataclass(frozen=True, eq=False)
class Roads:
    """All car lanes of a town, as read-only arrays. A *leg* is a lane together with the junction at its end."""

    tables: tuple[Points, Points, NDArray[np.float64], NDArray[np.float64]]
    """The first arguments of ``guide.update``: points (N, 2) of all lines, metres, and distances along them (N,); rows
    of LEG (legs, words) and of GATE (legs, 3, words). See :class:`~wrongturn_sim.guide.Net`."""
    exits: NDArray[np.float32]
    """(legs, 3, 60, 2): the exits as an observation shows them; zeros for exits that do not exist."""
    exits_mask: NDArray[np.int8]
    """(legs, 3)"""
    legs: Mapping[str, int]
    """Row of each lane, by its id."""
    names: tuple[str, ...]
    """Id of each row's lane."""
    lanes: tuple[Polyline, ...]
    """Centre line of each row's lane."""
    approaches: tuple[Approach | None, ...]
    """Approach of each row; None where the lane leads into no junction."""
    directions: tuple[frozenset[Command], ...]
    """Directions of the exits of each row."""

    @property
    def gates(self) -> NDArray[Any]:
        """(legs, 3): the exits of each leg."""
        return self.tables[3].view(GATE)[:, :, 0]

    def gate_of(self, leg: int, direction: Command) -> int:
        """Return the number of a leg's exit in a direction; raises KeyError where there is none."""
        approach = self.approaches[leg]
        for k, known in enumerate(approach.exits if approach is not None else ()):
            if known is direction:
                return k
        raise KeyError(direction)

    def path_of(self, leg: int, gate: int) -> tuple[Points, Points]:
        """Return the points (n, 2) and distances (n,) of an exit's path, which begins at the stop line."""
        found = self.gates[leg, gate]
        return self.tables[0][found.first : found.end], self.tables[1][found.first : found.end]


@once_per_net(16)
def roads_of(town: Town) -> Roads:
    """Return the roads of a town; they are made once."""
    rows = {name: row for row, name in enumerate(town.lanes)}
    lanes = tuple(Polyline(lane.centreline) for lane in town.lanes.values())
    approaches = tuple(town.approach_of_lane(name) for name in town.lanes)
    lines: list[Polyline] = []
    begins = [0]

    def put(path: Polyline) -> tuple[int, int]:
        lines.append(path)
        begins.append(begins[-1] + len(path.points))
        return begins[-2], begins[-1]

    legs = np.zeros((len(rows), words(LEG)))
    gates = np.zeros((len(rows), 3, words(GATE)))
    exits = np.zeros((len(rows), len(DIRECTIONS), PATH_POINTS, 2), np.float32)
    mask = np.zeros((len(rows), len(DIRECTIONS)), np.int8)
    for row, (lane, approach) in enumerate(zip(lanes, approaches, strict=True)):
        leg = legs[row].view(LEG)[0]
        leg.first, leg.end = put(lane)
        leg.length = lane.length
        if approach is None:
            continue
        leg.approach = 1
        leg.missing = approach.type.missing or 0
        opposite = town.lanes[approach.lane].opposite
        leg.back = rows[opposite] if opposite is not None else -1
        leg.gates = len(approach.exits)
        for k, exit_ in enumerate(approach.exits.values()):
            gate = gates[row, k].view(GATE)[0]
            onward = rows[exit_.lane]
            path = Polyline(np.concatenate([exit_.path, lanes[onward].points]))
            gate.direction, gate.leg = int(exit_.direction), onward
            gate.first, gate.end = put(path)
            (x, y), (x2, y2) = lanes[onward].points[:2].tolist()
            length = math.sqrt((x2 - x) * (x2 - x) + (y2 - y) * (y2 - y))
            gate.x, gate.y, gate.ux, gate.uy = x, y, (x2 - x) / length, (y2 - y) / length
            gate.half_width = town.lanes[exit_.lane].width / 2
            gate.inner = path.length - lanes[onward].length
            direction = DIRECTIONS.index(exit_.direction)
            fill(path.points, path.along, 0, len(path.points), 0.0, exits[row, direction])
            mask[row, direction] = 1
    points = np.concatenate([line.points for line in lines])
    along = np.concatenate([line.along for line in lines])
    for array in (points, along, legs, gates, exits, mask):
        array.setflags(write=False)
    tables = points, along, legs, gates
    directions = tuple(frozenset(one.exits if one is not None else ()) for one in approaches)
    return Roads(tables, exits, mask, MappingProxyType(rows), tuple(rows), lanes, approaches, directions)
