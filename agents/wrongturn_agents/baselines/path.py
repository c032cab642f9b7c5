"""Path to follow: a polyline that goes straight on at both ends."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_BEHIND = 6.0  # metres that a path extends back, so that a rear axle behind its first point projects onto it
_BEYOND = 30.0  # metres that a path extends past its last point, for looking ahead
_HALF_WINDOW = 2.0  # metres on either side over which curvature is measured: polylines have corners, streets do not


@dataclass(frozen=True, eq=False)
class Path:
    """Polyline in the town frame."""

    points: NDArray[np.float64]
    """Points, (N, 2), metres."""
    distances: NDArray[np.float64]
    """Distance of each point along the path from the first given point, (N,), metres; negative behind it."""
    stretches: NDArray[np.float64]
    """Unit vectors from each point to the next, (N - 1, 2)."""
    lengths: NDArray[np.float64]
    """Distances from each point to the next, (N - 1,), metres."""
    bends: NDArray[np.float64]
    """Absolute curvature at each point, (N,), 1/m."""

    @classmethod
    def through(cls, points: NDArray[Any]) -> "Path":
        """Return the path through (N, 2) points without repeated ones; at least two must differ.

        Raises:
            ValueError: Fewer than two points are distinct.
        """
        given = points.astype(np.float64)
        steps = np.hypot(*np.diff(given, axis=0).T)
        kept: NDArray[np.float64] = given[np.concatenate(([True], steps > 1e-3))]
        if len(kept) < 2:
            raise ValueError("points: a path needs two that differ")
        behind = kept[0] - _BEHIND * _unit(kept[1] - kept[0])
        beyond = kept[-1] + _BEYOND * _unit(kept[-1] - kept[-2])
        whole = np.concatenate(([behind], kept, [beyond]))
        vectors = np.diff(whole, axis=0)
        lengths = np.hypot(vectors[:, 0], vectors[:, 1])
        distances = np.concatenate(([0.0], np.cumsum(lengths))) - _BEHIND
        return cls(whole, distances, vectors / lengths[:, None], lengths, _curvature(vectors, distances))

    def project(self, x: float, y: float) -> float:
        """Return the distance along the path of its point nearest to (x, y), metres."""
        offset_x, offset_y = x - self.points[:-1, 0], y - self.points[:-1, 1]
        way_x, way_y = self.stretches[:, 0], self.stretches[:, 1]
        along = np.minimum(np.maximum(offset_x * way_x + offset_y * way_y, 0.0), self.lengths)
        miss_x, miss_y = offset_x - along * way_x, offset_y - along * way_y
        nearest = int((miss_x * miss_x + miss_y * miss_y).argmin())
        return float(self.distances[nearest] + along[nearest])

    def at(self, distance: float) -> tuple[float, float]:
        """Return the point at a distance along the path, metres."""
        return (
            float(np.interp(distance, self.distances, self.points[:, 0])),
            float(np.interp(distance, self.distances, self.points[:, 1])),
        )

    def speed_limit(self, distance: float, lateral: float, braking: float) -> float:
        """Return the greatest speed of a car at a distance along the path, m/s.

        In bends it keeps to a lateral acceleration, and it slows down for bends ahead by a deceleration, both m/s2.
        """
        ahead = self.distances - distance
        use = ahead > -_HALF_WINDOW
        squares = lateral / np.maximum(self.bends[use], 1e-6) + 2.0 * braking * np.maximum(ahead[use], 0.0)
        return math.sqrt(float(squares.min()))


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    return vector / math.hypot(vector[0], vector[1])


def _curvature(vectors: NDArray[np.float64], distances: NDArray[np.float64]) -> NDArray[np.float64]:
    headings = np.unwrap(np.arctan2(vectors[:, 1], vectors[:, 0]))
    middles = (distances[:-1] + distances[1:]) / 2.0
    turned = np.interp(distances + _HALF_WINDOW, middles, headings)
    turned -= np.interp(distances - _HALF_WINDOW, middles, headings)
    return np.asarray(np.abs(turned) / (2.0 * _HALF_WINDOW))


def from_place(
    place: NDArray[Any], heading: float, forward: NDArray[np.float64], aside: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return (N, 2) points of the town that lie so far forward and to the left of a place, metres and radians."""
    cos, sin = math.cos(heading), math.sin(heading)
    return np.stack((place[0] + cos * forward - sin * aside, place[1] + sin * forward + cos * aside), axis=1)
