"""Lanes for cars."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon

Line = NDArray[np.float64]
"""(N, 2), metres, town frame, read-only."""


@dataclass(frozen=True, eq=False)
class Lane:
    """A lane for cars between junctions."""

    id: str
    edge: str
    width: float
    """Metres."""
    length: float
    """Of the centre line, metres."""
    centreline: Line
    """(N, 2), metres, in the direction of travel."""
    polygon: Polygon
    start_junction: str | None
    """Where it begins; None at a dead end."""
    end_junction: str | None
    """Where it ends; None at a dead end."""
    opposite: str | None
    """The car lane of the same street the other way."""


def heading_at_end(line: Line) -> float:
    """Heading of a line's last piece, radians."""
    dx, dy = line[-1] - line[-2]
    return float(np.arctan2(dy, dx))


def heading_at_start(line: Line) -> float:
    """Heading of a line's first piece, radians."""
    dx, dy = line[1] - line[0]
    return float(np.arctan2(dy, dx))
