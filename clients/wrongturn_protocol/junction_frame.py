"""The frame in which trials at junctions are drawn over one another, and the shape at the end of each path."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wrongturn_protocol.vocabulary import Verdict

Points = NDArray[np.float64]
"""Points (n, 2), metres."""
SHAPES: Final = {
    Verdict.COLLISION: "star",
    Verdict.OFF_ROAD: "cross",
    Verdict.STOPPED_IN_JUNCTION: "block",
    Verdict.WRONG_WAY: "triangle",
    Verdict.STOPPED_BEFORE_JUNCTION: "bar",
    Verdict.EXIT_COMMANDED: "dot",
    Verdict.EXIT_ROUTE: "dot",
    Verdict.EXIT_OTHER: "dot",
}
"""Shape at the end of a path, by verdict."""


def shape(verdict: Verdict) -> str:
    """Return the name of a verdict's shape; the others have a diamond."""
    return SHAPES.get(verdict, "diamond")


@dataclass(frozen=True)
class Frame:
    """Frame of an approach: the car drives in along +y, and x is to its right; metres.

    Pages have the junction's node at (0, 0), so that all approaches of a type lie on each other; figures have the
    middle of the stop line there.
    """

    origin: tuple[float, float]
    """Town frame, metres."""
    heading: float
    """Heading of the approach's lane at the stop line, town frame, radians."""

    def turned(self, points: ArrayLike) -> Points:
        """Return points (n, 2) of the town's frame in this one."""
        sin, cos = math.sin(self.heading), math.cos(self.heading)
        turn: Points = np.array([[sin, cos], [-cos, sin]])
        return np.asarray((np.asarray(points, np.float64) - self.origin) @ turn)


def rings(geometry: dict[str, Any]) -> Iterable[list[Points]]:
    """Yield the polygons of a GeoJSON geometry, each as its outer ring and its holes, (n, 2)."""
    polygons = geometry["coordinates"] if geometry["type"] == "MultiPolygon" else [geometry["coordinates"]]
    for polygon in polygons:
        yield [np.asarray([point[:2] for point in ring], np.float64) for ring in polygon]
