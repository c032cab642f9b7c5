"""A town's lanes and exits as the arrays that ``guide.py`` reads."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from wrongturn_networks import Approach, Town
from wrongturn_protocol import DIRECTIONS, Command
from wrongturn_protocol.observations import PATH_POINTS
from wrongturn_sim import guide
from wrongturn_sim.polyline import Points, Polyline


@dataclass(frozen=True, eq=False)
class Roads:
    """All car lanes of a town, as read-only arrays. A *leg* is a lane together with the junction at its end."""

    points: Points
    """(N, 2), metres: points of every lane, and of every exit's path, which leads from the stop line through the
    junction and along the exit's lane."""
    along: Points
    """(N,): distances along each line, metres."""
    ints: NDArray[np.int64]
    """(legs, LEG_INTS)"""
    floats: NDArray[np.float64]
    """(legs, LEG_FLOATS)"""
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

    def gate_of(self, leg: int, direction: Command) -> int:
        """Return the number of a leg's exit in a direction; raises KeyError where there is none."""
        approach = self.approaches[leg]
        for k, known in enumerate(approach.exits if approach is not None else ()):
            if known is direction:
                return k
        raise KeyError(direction)

    def path_of(self, leg: int, gate: int) -> tuple[Points, Points]:
        """Return the points (n, 2) and distances (n,) of an exit's path, which begins at the stop line."""
        at = guide.L_GATE + guide.GATE_INTS * gate
        first, end = self.ints[leg, at + guide.G_FIRST], self.ints[leg, at + guide.G_END]
        return self.points[first:end], self.along[first:end]

    @property
    def tables(self) -> tuple[Points, Points, NDArray[np.int64], NDArray[np.float64]]:
        """The first four arguments of ``guide.update``."""
        return self.points, self.along, self.ints, self.floats


@lru_cache(maxsize=16)
def roads_of(town: Town) -> Roads:
    """Return the roads of a town; they are made once."""
    legs = {name: row for row, name in enumerate(town.lanes)}
    lanes = tuple(Polyline(lane.centreline) for lane in town.lanes.values())
    approaches = tuple(town.approach_of_lane(name) for name in town.lanes)
    lines: list[Polyline] = []
    begins = [0]

    def put(path: Polyline) -> tuple[int, int]:
        lines.append(path)
        begins.append(begins[-1] + len(path.points))
        return begins[-2], begins[-1]

    ints = np.zeros((len(legs), guide.LEG_INTS), np.int64)
    floats = np.zeros((len(legs), guide.LEG_FLOATS))
    exits = np.zeros((len(legs), len(DIRECTIONS), PATH_POINTS, 2), np.float32)
    mask = np.zeros((len(legs), len(DIRECTIONS)), np.int8)
    for leg, (lane, approach) in enumerate(zip(lanes, approaches, strict=True)):
        ints[leg, guide.L_FIRST : guide.L_END + 1] = put(lane)
        floats[leg, guide.F_LENGTH] = lane.length
        if approach is None:
            continue
        ints[leg, guide.L_APPROACH] = 1
        ints[leg, guide.L_MISSING] = approach.type.missing or 0
        opposite = town.lanes[approach.lane].opposite
        ints[leg, guide.L_BACK] = legs[opposite] if opposite is not None else -1
        ints[leg, guide.L_GATES] = len(approach.exits)
        for k, exit_ in enumerate(approach.exits.values()):
            onward = legs[exit_.lane]
            path = Polyline(exit_.path).then(lanes[onward])
            at = guide.L_GATE + guide.GATE_INTS * k
            ints[leg, at : at + guide.GATE_INTS] = int(exit_.direction), onward, *put(path)
            (x, y), (x2, y2) = lanes[onward].points[:2].tolist()
            ux, uy = x2 - x, y2 - y
            length = math.sqrt(ux * ux + uy * uy)
            half_width = town.lanes[exit_.lane].width / 2
            at = guide.F_GATE + guide.GATE_FLOATS * k
            floats[leg, at : at + guide.GATE_FLOATS] = (
                x,
                y,
                ux / length,
                uy / length,
                half_width,
                path.length - lanes[onward].length,
            )
            row = DIRECTIONS.index(exit_.direction)
            exits[leg, row] = path.sample(0.0, PATH_POINTS)
            mask[leg, row] = 1
    points = np.concatenate([line.points for line in lines])
    along = np.concatenate([line.along for line in lines])
    for array in (points, along, ints, floats, exits, mask):
        array.setflags(write=False)
    return Roads(points, along, ints, floats, exits, mask, MappingProxyType(legs), tuple(legs), lanes, approaches)
