"""Paths as polylines: where a point lies beside one, and points along one at equal distances."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Points = NDArray[np.float64]


@njit(cache=True)
def measure(points: Points) -> Points:
    """Distance from the first point along the line to each, metres, (N,)."""
    along = np.zeros(points.shape[0])
    for i in range(1, points.shape[0]):
        dx = points[i, 0] - points[i - 1, 0]
        dy = points[i, 1] - points[i - 1, 1]
        along[i] = along[i - 1] + math.sqrt(dx * dx + dy * dy)
    return along


@njit(cache=True)
def project(points: Points, along: Points, first: int, end: int, x: float, y: float) -> tuple[float, float, float]:
    """The nearest place of a line to a point.

    Args:
        points: (N, 2), metres, of one line or of many after one another.
        along: (N,), as :func:`measure` gives for each line.
        first: where the line begins.
        end: behind its last point; it has at least two.
        x: of the point, metres.
        y: of the point, metres.

    Returns:
        Distance along the line to that place (metres); distance of the point from it (metres, positive to the left);
        heading of the line there (radians).
    """
    best = math.inf
    at = 0.0
    side = 0.0
    ex = 1.0
    ey = 0.0
    for i in range(first, end - 1):
        ax = points[i, 0]
        ay = points[i, 1]
        ux = points[i + 1, 0] - ax
        uy = points[i + 1, 1] - ay
        length = along[i + 1] - along[i]
        if length <= 0.0:
            continue
        px = x - ax
        py = y - ay
        share = (px * ux + py * uy) / (length * length)
        if share < 0.0:
            share = 0.0
        elif share > 1.0:
            share = 1.0
        dx = px - share * ux
        dy = py - share * uy
        square = dx * dx + dy * dy
        if square < best:
            best = square
            at = along[i] + share * length
            side = ux * py - uy * px
            ex = ux
            ey = uy
    distance = math.sqrt(best)
    return at, (distance if side >= 0.0 else -distance), math.atan2(ey, ex)


@njit(cache=True)
def fill(points: Points, along: Points, first: int, end: int, begin: float, out: NDArray[np.float32]) -> None:
    """Points of a line 1 m apart from ``begin`` on; past its end, the last one again and again.

    Args:
        points: (N, 2), metres, of one line or of many after one another.
        along: (N,), as :func:`measure` gives for each line.
        first: where the line begins.
        end: behind its last point.
        begin: metres along the line.
        out: (M, 2), written.
    """
    last = end - 1
    i = first
    for row in range(out.shape[0]):
        s = begin + row
        while i < last and along[i + 1] < s:
            i += 1
        if i == last:
            out[row, 0] = points[last, 0]
            out[row, 1] = points[last, 1]
        else:
            length = along[i + 1] - along[i]
            share = (s - along[i]) / length if length > 0.0 else 0.0
            out[row, 0] = points[i, 0] + share * (points[i + 1, 0] - points[i, 0])
            out[row, 1] = points[i, 1] + share * (points[i + 1, 1] - points[i, 1])


class Projection(NamedTuple):
    """Where a point lies beside a path."""

    s: float
    """Metres along the path."""
    lateral: float
    """Metres, positive to the left."""
    heading: float
    """Of the path there, radians."""


class Polyline:
    """A polyline with its distances."""

    __slots__ = ("along", "length", "points")

    def __init__(self, points: Any) -> None:
        self.points: Points = np.ascontiguousarray(points, np.float64)
        self.along: Points = measure(self.points)
        self.length = float(self.along[-1])

    def project(self, x: float, y: float) -> Projection:
        """The nearest place of the path."""
        return Projection(*project(self.points, self.along, 0, len(self.points), x, y))

    def then(self, other: "Polyline") -> "Polyline":
        """This path and another one after it."""
        return Polyline(np.concatenate([self.points, other.points]))

    def sample(self, begin: float, count: int) -> NDArray[np.float32]:
        """Points 1 m apart from ``begin`` on, (count, 2); past the end, the last one again."""
        out = np.empty((count, 2), np.float32)
        fill(self.points, self.along, 0, len(self.points), begin, out)
        return out
