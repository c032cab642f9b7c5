"""A town's map as SVG, with a mark at each approach."""

import math
from typing import Any, Final, NamedTuple

import numpy as np

from wrongturn_protocol import Command, JunctionType, TownDetail
from wrongturn_protocol.junction_frame import rings

_BACK: Final = 9.0
"""Metres from the stop line back to the middle of an approach's mark."""
_MARGIN: Final = 10.0
"""Metres around the town."""


class ApproachMark(NamedTuple):
    """The mark of an approach, in the map's frame: metres, y down."""

    id: str
    type: JunctionType
    x: float
    y: float
    degrees: float
    """Turn of the mark, clockwise. A mark without a turn is driven upwards."""


class TownMap(NamedTuple):
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
    return {
        JunctionType.LEFT_RIGHT: "M-5 -5H5V5H-5z",
        JunctionType.STRAIGHT_LEFT: "M-6.5 0L3.5 -6V6z",
        JunctionType.STRAIGHT_RIGHT: "M-3 -6a6 6 0 0 1 0 12z",
        JunctionType.CROSS: "M-5 0a5 5 0 1 0 10 0a5 5 0 1 0 -10 0z",
    }[kind]


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
