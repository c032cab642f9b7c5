"""The road around an approach, turned so that the car comes from below: what trajectories are drawn over."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from wrongturn_agents.errors import ResultsError
from wrongturn_client import Client
from wrongturn_client.plugins import entry_points, load
from wrongturn_protocol import ApproachDetail, TownDetail

Point = tuple[float, float]
Ring = tuple[Point, ...]
FindTown = Callable[[str], TownDetail]
"""Returns a town by its name."""


@dataclass(frozen=True)
class Frame:
    """Frame of an approach: the stop line's middle at (0, 0), the car driving along +y, metres."""

    origin: Point
    heading: float
    """Heading at the stop line, town frame, radians."""

    @classmethod
    def of(cls, approach: ApproachDetail) -> "Frame":
        """Return the frame of an approach."""
        return cls(approach.stop_line, approach.heading)

    def turned(self, points: Iterable[Point]) -> Ring:
        """Return points of the town's frame in this one."""
        across, along = math.sin(self.heading), math.cos(self.heading)
        (x0, y0) = self.origin
        return tuple(((x - x0) * across - (y - y0) * along, (x - x0) * along + (y - y0) * across) for x, y in points)


def rings(geometry: dict[str, Any]) -> list[list[Ring]]:
    """Return the polygons of a GeoJSON geometry, each as its outer ring and its holes."""
    polygons = geometry["coordinates"] if geometry["type"] == "MultiPolygon" else [geometry["coordinates"]]
    return [[tuple((float(x), float(y)) for x, y, *_ in ring) for ring in polygon] for polygon in polygons]


@lru_cache(maxsize=32)
def installed_town(name: str) -> TownDetail:
    """Return a town that is installed here.

    Raises:
        ResultsError: wrongturn-networks is not installed, or has no such town.
    """
    point = entry_points("wrongturn.towns").get("shipped")
    if point is None:
        raise ResultsError("no towns are installed here; install wrongturn-networks (again)")
    try:
        found: TownDetail = load(point)(name).detail({})
    except ValueError as error:
        raise ResultsError(str(error)) from error
    return found


def town_of(url: str) -> FindTown:
    """Return a function that gets towns from a service, each once."""

    @lru_cache(maxsize=32)
    def find(name: str) -> TownDetail:
        with Client(url, "", patience=0) as client:
            return client.town(name)

    return find
