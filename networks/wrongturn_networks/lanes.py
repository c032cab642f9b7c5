"""Car lanes and their bends."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon

Line = NDArray[np.float64]
"""Points (n, 2), metres, town frame, read-only."""

_KINK: Final = math.radians(0.5)
"""Two pieces of a street whose headings differ by less are straight, radians."""
_APART: Final = 5.0
"""Two bends are separate if more than this of straight lane lies between them, metres."""


@dataclass(frozen=True, eq=False)
class Lane:
    """A car lane between junctions."""

    id: str
    edge: str
    width: float
    """Width, metres."""
    length: float
    """Length of the centre line, metres."""
    centreline: Line
    """(n, 2), metres, in the direction of travel."""
    polygon: Polygon
    """Area of all car lanes of its direction."""
    start_junction: str | None
    """Junction where it begins; None at a dead end."""
    end_junction: str | None
    """Junction where it ends; None at a dead end."""
    opposite: str | None
    """Id of the same street's lane in the opposite direction; None in a one-way street."""
    axis: float
    """Distance of the street's axis from the centre line, metres: positive, as it lies to the left, in right-hand
    traffic; negative in left-hand traffic."""
    kerb: float
    """Distance of the kerb from the centre line, metres, on the side away from the axis."""
    middle: Line
    """(n, 2), metres: middle of all car lanes of its direction; the centre line itself if there is only one."""
    breadth: float
    """Width of all car lanes of its direction, metres."""


def heading_of(piece: Line) -> float:
    """Return the heading of a straight piece (2, 2) of a line, radians."""
    dx, dy = piece[1] - piece[0]
    return float(np.arctan2(dy, dx))


class Bend(NamedTuple):
    """A bend of a lane: its start and end, metres along the lane."""

    begin: float
    end: float


@lru_cache(maxsize=1024)
def bends_of(lane: Lane) -> tuple[Bend, ...]:
    """Return a lane's bends in the direction of travel."""
    steps = np.diff(lane.centreline, axis=0)
    along = np.cumsum(np.sqrt((steps**2).sum(axis=1)))[:-1]
    headings = np.arctan2(steps[:, 1], steps[:, 0])
    turns = np.remainder(np.diff(headings) + math.pi, math.tau) - math.pi
    bends: list[Bend] = []
    for place in along[np.abs(turns) > _KINK].tolist():
        if bends and place - bends[-1].end <= _APART:
            bends[-1] = Bend(bends[-1].begin, place)
        else:
            bends.append(Bend(place, place))
    return tuple(bends)
