"""Bends of lanes between junctions."""

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from wrongturn_networks.lanes import Lane

_KINK: Final = math.radians(0.5)
"""Two pieces of a street whose headings differ by less are straight, radians."""
_APART: Final = 5.0
"""Two bends are separate if more than this of straight lane lies between them, metres."""


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
