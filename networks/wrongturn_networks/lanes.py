"""Car lanes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon

Line = NDArray[np.float64]
"""Points (n, 2), metres, town frame, read-only."""


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
    start_junction: str | None
    """Junction where it begins; None at a dead end."""
    end_junction: str | None
    """Junction where it ends; None at a dead end."""
    opposite: str | None
    """Id of the same street's lane in the opposite direction."""


def heading_at_end(line: Line) -> float:
    """Return the heading of a line's last piece, radians."""
    dx, dy = line[-1] - line[-2]
    return float(np.arctan2(dy, dx))


def heading_at_start(line: Line) -> float:
    """Return the heading of a line's first piece, radians."""
    dx, dy = line[1] - line[0]
    return float(np.arctan2(dy, dx))
