"""Polylines: the nearest place to a point, and points at equal distances."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wrongturn_judge.compiling import compiled

Points = NDArray[np.float64]


def measure(points: Points) -> Points:
    """Return the distance along the line from its first point to each of its points (N, 2), as (N,), metres."""
    steps = np.diff(points, axis=0)
    return np.concatenate(([0.0], np.cumsum(np.sqrt(steps[:, 0] ** 2 + steps[:, 1] ** 2))))


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


class Polyline:
    """A line of points, with the distance of each along it."""

    def __init__(self, points: Any) -> None:
        self.points: Points = np.ascontiguousarray(points, np.float64)
        self.along: Points = measure(self.points)
        self.length = float(self.along[-1])

    def at(self, s: float) -> tuple[float, float, float]:
        """Return x, y and heading at a distance along the line; past its ends it goes on straight."""
        i = min(max(int(np.searchsorted(self.along, s, side="right")) - 1, 0), len(self.along) - 2)
        (ax, ay), (bx, by) = self.points[i].tolist(), self.points[i + 1].tolist()
        heading, ahead = math.atan2(by - ay, bx - ax), s - float(self.along[i])
        return ax + ahead * math.cos(heading), ay + ahead * math.sin(heading), heading
