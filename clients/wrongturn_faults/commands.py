"""Commands, and the orders in which other programs write them as one-hot vectors."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum


class Command(IntEnum):
    """High-level navigation command, with the numbers of CARLA's ``RoadOption``."""

    VOID = -1
    LEFT = 1
    RIGHT = 2
    STRAIGHT = 3
    LANE_FOLLOW = 4


DIRECTIONS = (Command.LEFT, Command.RIGHT, Command.STRAIGHT)
"""Commands that name an exit of a junction, in the order of every array over exits."""

NAVSIM = (Command.LEFT, Command.STRAIGHT, Command.RIGHT, Command.VOID)
"""NAVSIM's order: left, straight, right, unknown. It has no command of its own for following the lane."""
CARLA = (Command.LEFT, Command.RIGHT, Command.STRAIGHT, Command.LANE_FOLLOW)
"""Order of CARLA's numbers from 1 on; TransFuser and TCP append the two lane changes, which no fault delivers."""

OPENPILOT = (Command.LANE_FOLLOW, Command.LEFT, Command.RIGHT)
"""openpilot's desires: none, turn left, turn right. Five more follow (``length=8``), which no fault delivers."""


def one_hot(command: int, order: Sequence[int], length: int | None = None) -> list[float]:
    """Return a command as a one-hot vector in an order, with zeros behind it up to a length.

    In an order without LANE_FOLLOW it is written as STRAIGHT, and in one without STRAIGHT or VOID these are written as
    LANE_FOLLOW. Raises ValueError if the order has neither.
    """
    stand_ins = {
        Command.LANE_FOLLOW: Command.STRAIGHT,
        Command.STRAIGHT: Command.LANE_FOLLOW,
        Command.VOID: Command.LANE_FOLLOW,
    }
    meant = command if command in order else stand_ins.get(Command(command), command)
    if meant not in order:
        raise ValueError(f"command: {Command(command).name} has no place in the order {[int(one) for one in order]}")
    vector = [0.0] * max(len(order), length or 0)
    vector[list(order).index(meant)] = 1.0
    return vector


def from_one_hot(vector: Sequence[float], order: Sequence[int]) -> Command:
    """Return the command of a one-hot vector. Raises ValueError if not just one number of it is above 0.5."""
    places = [place for place, value in enumerate(vector) if value > 0.5]
    if len(places) != 1 or places[0] >= len(order):
        raise ValueError(
            f"vector: {list(vector)} does not have a single 1 at one of the {len(order)} places of the order"
        )
    return Command(order[places[0]])
