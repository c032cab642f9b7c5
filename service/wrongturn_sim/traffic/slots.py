"""Where other road users may be when a trial begins: apart from each other, and clear of the ego."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_networks import Town
from wrongturn_networks.lanes import Line
from wrongturn_sim.traffic.sidewalks import along_of, sidewalks_of

CLEARANCE: Final = 15.0
"""No car's front begins nearer to the ego's centre than this, metres."""
PEDESTRIAN_CLEARANCE: Final = 5.0
"""The same of pedestrians."""
FIRST: Final = 6.5
"""The first place of a lane, metres from its begin: a whole body fits behind the front bumper."""
JITTER: Final = 1.5
"""So far a front may be past its place, metres."""
_PITCH: Final = 10.0  # of fronts: the longest body, the jitter and SUMO's gap between cars that stand
_LAST: Final = 3.0  # from the last front to the stop line
_PACE: Final = 2.0  # of sidewalk to a pedestrian


@dataclass(frozen=True, eq=False)
class Slots:
    """Where somebody may begin."""

    places: tuple[tuple[str, float], ...]
    """Lane or edge, and metres along it."""
    points: NDArray[np.float64]
    """(n, 2): where that is."""
    clearance: float
    """From the ego's start, metres."""

    def free(self, x: float, y: float) -> list[int]:
        """Which are far enough from the ego's start, in order."""
        dx, dy = self.points[:, 0] - x, self.points[:, 1] - y
        indices: list[int] = np.flatnonzero(dx * dx + dy * dy >= self.clearance**2).tolist()
        return indices


@lru_cache(maxsize=16)
def car_slots(town: Town) -> Slots:
    """Where front bumpers may be, so that neighbours keep apart whatever their bodies and jitter."""
    lines = {name: lane.centreline for name, lane in town.lanes.items()}
    return _slots(lines, FIRST, _PITCH, _LAST + JITTER, CLEARANCE)


@lru_cache(maxsize=16)
def pedestrian_slots(town: Town) -> Slots:
    """Where pedestrians may be."""
    return _slots(sidewalks_of(town).lines, _PACE, _PACE, _PACE, PEDESTRIAN_CLEARANCE)


def _slots(lines: Mapping[str, Line], first: float, pitch: float, last: float, clearance: float) -> Slots:
    places: list[tuple[str, float]] = []
    points = [np.empty((0, 2))]
    for name, line in sorted(lines.items()):
        along = along_of(line)
        at = np.arange(first, float(along[-1]) - last, pitch)
        places += [(name, place) for place in at.tolist()]
        points.append(np.column_stack((np.interp(at, along, line[:, 0]), np.interp(at, along, line[:, 1]))))
    return Slots(tuple(places), np.concatenate(points), clearance)
