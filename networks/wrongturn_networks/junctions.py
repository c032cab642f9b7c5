"""Junctions, and their approaches and exits as seen by a car that drives in."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from shapely.geometry.base import BaseGeometry

from wrongturn_networks.lanes import Line
from wrongturn_protocol import Command, JunctionType

STRAIGHT_WITHIN: Final = math.radians(45)
"""An exit is straight on if its lane's heading differs from the approach's by at most this, radians."""

COMPASS: Final = ("E", "N", "W", "S")
"""Names of a junction's arms by their direction from it, counter-clockwise from east."""


@dataclass(frozen=True, eq=False)
class Exit:
    """A permitted way out of a junction from one approach."""

    direction: Command
    lane: str
    """The car lane that leaves the junction."""
    internal_lanes: tuple[str, ...]
    """SUMO's lanes inside the junction in the order of travel; a left turn has two."""
    path: Line
    """(n, 2), metres: the path from the stop line to the exit line."""


@dataclass(frozen=True, eq=False)
class Approach:
    """One arm of a junction, as seen by a car that drives in."""

    id: str
    """Junction and arm. Example: ``J3-S``, junction J3 from its southern arm."""
    junction: str
    lane: str
    """The incoming car lane."""
    type: JunctionType
    exits: Mapping[Command, Exit]
    """Exits by direction, in the order left, right, straight."""
    stop_line: tuple[float, float]
    """End of the lane, metres."""
    heading: float
    """Heading of the lane at the stop line, radians."""


@dataclass(frozen=True, eq=False)
class Junction:
    """A place where roads meet; bends and dead ends are not junctions."""

    id: str
    position: tuple[float, float]
    """Position of its node, metres."""
    area: BaseGeometry
    """The part of its shape that is road, without walking areas."""
    approaches: tuple[str, ...]
    """Ids of its approaches."""


def direction_of(turn: float) -> Command:
    """Return the command that names a turn: the exit's heading minus the approach's, radians, positive to the left."""
    turn = math.remainder(turn, math.tau)
    if abs(turn) <= STRAIGHT_WITHIN:
        return Command.STRAIGHT
    return Command.LEFT if turn > 0 else Command.RIGHT


def arms_of(headings: Sequence[float]) -> list[str]:
    """Return the names of a junction's arms, by which cars with these headings (radians) drive in.

    Where two would have one name, the compass is turned so that it fits the arms best.
    """
    quarter = math.pi / 2

    def names(turned: float) -> list[str]:
        return [COMPASS[round((heading + math.pi - turned) / quarter) % 4] for heading in headings]

    if len(set(names(0.0))) == len(headings):
        return names(0.0)
    across, along = (sum(part(4 * heading) for heading in headings) for part in (math.sin, math.cos))
    return names(math.atan2(across, along) / 4)
