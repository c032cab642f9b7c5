"""Junctions, their approaches and exits, as a car driving in sees them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from shapely.geometry.base import BaseGeometry

from wrongturn_networks.lanes import Line
from wrongturn_protocol import Command, JunctionType

STRAIGHT_WITHIN: Final = math.radians(45)
"""An exit is straight on if its lane's heading differs by no more than this from the approach's."""

COMPASS: Final = ("E", "N", "W", "S")
"""Names of a junction's arms, by the direction in which they lie from it, counter-clockwise from east."""


@dataclass(frozen=True, eq=False)
class Exit:
    """One way out of a junction, permitted from one approach."""

    direction: Command
    lane: str
    """The car lane that leaves the junction."""
    internal_lanes: tuple[str, ...]
    """SUMO's lanes inside the junction, in the order of travel (a left turn has two)."""
    path: Line
    """(N, 2), metres: from the stop line through the internal lanes to the exit line."""


@dataclass(frozen=True, eq=False)
class Approach:
    """One arm of a junction, seen by a car driving in."""

    id: str
    """Junction and arm, such as ``J3-S``: junction J3 from its southern arm."""
    junction: str
    lane: str
    """The incoming car lane."""
    type: JunctionType
    exits: Mapping[Command, Exit]
    """By direction, in the order left, right, straight."""
    stop_line: tuple[float, float]
    """The end of the lane, metres."""
    heading: float
    """Of the lane at the stop line, radians."""


@dataclass(frozen=True, eq=False)
class Junction:
    """A place where roads meet; bends and dead ends are none."""

    id: str
    position: tuple[float, float]
    """Of its node, metres."""
    radius: float
    """Of its rounded corners, metres."""
    area: BaseGeometry
    """Its shape cut with the road, that is without walking areas."""
    approaches: tuple[str, ...]
    """Their ids."""


def direction_of(turn: float) -> Command:
    """The command that names a turn.

    Args:
        turn: heading of the exit's lane less that of the approach's, radians, positive to the left.
    """
    turn = math.remainder(turn, math.tau)
    if abs(turn) <= STRAIGHT_WITHIN:
        return Command.STRAIGHT
    return Command.LEFT if turn > 0 else Command.RIGHT


def arm_of(heading: float) -> str:
    """The compass name of the arm by which a car with this heading (radians) drives in."""
    return COMPASS[round(math.remainder(heading + math.pi, math.tau) / (math.pi / 2)) % 4]
