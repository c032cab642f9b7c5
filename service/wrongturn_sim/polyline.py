"""Polylines: the nearest place to a point, and points at equal distances."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wrongturn_judge.compiling import compiled

Points = NDArray[np.float64]


@compiled()
def measure(points: Points) -> Points:
    """Return the distance along the line from its first point to each point, (N,), metres."""
    along = np.zeros(points.shape[0])
    for i in range(1, points.shape[0]):
        dx = points[i, 0] - points[i - 1, 0]
        dy = points[i, 1] - points[i - 1, 1]
        along[i] = along[i - 1] + math.sqrt(dx * dx + dy * dy)
    return along


@compiled()
def project(points: Points, along: Points, first: int, end: int, x: float, y: float) -> tuple[float, float, float]:
    """Return the place on a line that is nearest to a point.

    ``points`` (N, 2) and ``along`` (N,), as :func:`measure` returns it, can hold several lines, one after the
    other. The line has those from ``first`` to before ``end``, two at least. All are metres.

    Returns:
        Distance along the line to that place, metres; distance of the point from it, metres, positive to the left;
        heading of the line there, radians.
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


@compiled()
def fill(points: Points, along: Points, first: int, end: int, begin: float, out: NDArray[np.float32]) -> None:
    """Fill ``out`` (M, 2) with points of a line, 1 m apart, from ``begin`` metres along it; past its end with its end.

    The line is given as for :func:`project`.
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
    """Where a point lies beside a polyline."""

    s: float
    """Metres along the line."""
    lateral: float
    """Distance from the line, metres, positive to the left."""
    heading: float
    """Heading of the line there, radians."""


class Polyline:
    """A line of points, with the distance of each along it."""

    __slots__ = ("along", "length", "points")

    def __init__(self, points: Any) -> None:
        self.points: Points = np.ascontiguousarray(points, np.float64)
        self.along: Points = measure(self.points)
        self.length = float(self.along[-1])

    def project(self, x: float, y: float) -> Projection:
        """Return the place that is nearest to a point."""
        return Projection(*project(self.points, self.along, 0, len(self.points), x, y))

    def then(self, other: "Polyline") -> "Polyline":
        """Return this line with another one appended."""
        return Polyline(np.concatenate([self.points, other.points]))

    def sample(self, begin: float, count: int) -> NDArray[np.float32]:
        """Return points 1 m apart, starting at ``begin`` metres, (count, 2); past the end the last one is repeated."""
        out = np.empty((count, 2), np.float32)
        fill(self.points, self.along, 0, len(self.points), begin, out)
        return out
