"""A town's map as SVG, with a mark at each approach."""

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from wrongturn_protocol import Command, JunctionType, TownDetail
from wrongturn_protocol.junction_frame import rings

_BACK: Final = 9.0
"""Metres from the stop line back to the middle of an approach's mark."""
_MARGIN: Final = 10.0
"""Metres around the town."""
RADIUS: Final = 5.0
"""Half the size of a mark, metres."""


@dataclass(frozen=True)
class ApproachMark:
    """The mark of an approach, in the map's frame: metres, y down."""

    id: str
    type: JunctionType
    x: float
    y: float
    degrees: float
    """Turn of the mark, clockwise. A mark without a turn is driven upwards."""


@dataclass(frozen=True)
class TownMap:
    """What the template draws, in metres with y down."""

    box: str
    """SVG's ``viewBox``."""
    road: str
    """Drivable area as an SVG path, with the rule ``evenodd``."""
    junctions: tuple[tuple[str, float, float], ...]
    """Name of each junction, and the middle of its area."""
    approaches: tuple[ApproachMark, ...]


def town_map(town: TownDetail) -> TownMap:
    """Return the map of a town."""
    left, bottom, right, top = town.bounds
    width, height = right - left + 2 * _MARGIN, top - bottom + 2 * _MARGIN
    return TownMap(
        box=f"{left - _MARGIN:.1f} {-top - _MARGIN:.1f} {width:.1f} {height:.1f}",
        road=_path(town.road),
        junctions=tuple((name, *_middle(area)) for name, area in town.junctions.items()),
        approaches=tuple(
            ApproachMark(
                id=approach.id,
                type=approach.type,
                x=round(approach.stop_line[0] - _BACK * math.cos(approach.heading), 1),
                y=round(-approach.stop_line[1] + _BACK * math.sin(approach.heading), 1),
                degrees=round(90.0 - math.degrees(approach.heading), 1) % 360.0,
            )
            for approach in town.approaches
        ),
    )


def shape(kind: JunctionType) -> str:
    """Return the outline of a type's mark around (0, 0), as an SVG path.

    Each type has a shape of its own: where one exit is missing on a side, the mark points to the other side.
    """
    r = RADIUS
    if kind is JunctionType.LEFT_RIGHT:
        return f"M{-r} {-r}H{r}V{r}H{-r}z"
    if kind is JunctionType.STRAIGHT_LEFT:
        return f"M{-r * 1.3} 0L{r * 0.7} {-r * 1.2}V{r * 1.2}z"
    if kind is JunctionType.STRAIGHT_RIGHT:
        return f"M{-r * 0.6} {-r * 1.2}a{r * 1.2} {r * 1.2} 0 0 1 0 {r * 2.4}z"
    return f"M{-r} 0a{r} {r} 0 1 0 {2 * r} 0a{r} {r} 0 1 0 {-2 * r} 0z"


def glyph(kind: JunctionType) -> str:
    """Return the way in from below and the exits of a type, as an SVG path in a box from -8 to 8."""
    ends = {Command.LEFT: "H-7", Command.RIGHT: "H7", Command.STRAIGHT: "V-7"}
    return "M0 8V0" + "".join(f"M0 0{end}" for command, end in ends.items() if command in kind.exits)


def _path(geometry: dict[str, Any]) -> str:
    every = (ring for polygon in rings(geometry) for ring in polygon)
    return "".join("M" + "L".join(f"{x:.1f} {-y:.1f}" for x, y in ring.tolist()) + "z" for ring in every)


def _middle(area: dict[str, Any]) -> tuple[float, float]:
    """Return the middle of an area's bounds."""
    points = np.concatenate([ring for polygon in rings(area) for ring in polygon])
    x, y = ((points.min(axis=0) + points.max(axis=0)) / 2).tolist()
    return round(x, 1), round(-y, 1)
