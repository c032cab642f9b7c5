"""The reward of practice and training: the paper's, r = (v* - |v* - v|) + 10 (1 - d) + 0.1 (15 - |a|)."""

import math
from typing import Final

from numba import njit

from wrongturn_protocol import Command
from wrongturn_sim.faults.fault import Guidance

CRUISING: Final = 35.0
"""v* outside a junction's window, km/h."""
TURNING: Final = 15.0
"""v* within it."""
_KMH: Final = 3.6
_TURN: Final = 2.0 * math.pi
_DEGREES: Final = 180.0 / math.pi


@njit(cache=True)
def score(v: float, yaw: float, turning: bool, lateral: float, heading: float) -> float:
    """The formula itself.

    Args:
        v: m/s; the formula's is in km/h.
        yaw: of the car, radians.
        turning: whether this is within a junction's window.
        lateral: of the car beside its path, metres.
        heading: of that path, radians.
    """
    target = TURNING if turning else CRUISING
    angle = abs(yaw - heading) % _TURN
    angle = min(angle, _TURN - angle) * _DEGREES
    return (target - abs(target - v * _KMH)) + 10.0 * (1.0 - abs(lateral)) + 0.1 * (15.0 - angle)


def reward(v: float, yaw: float, guidance: Guidance) -> float:
    """How well the car drives at this instant.

    Args:
        v: m/s.
        yaw: of the car, radians.
        guidance: of the route, for the window, the distance d from its path (m) and the angle a to it (degrees).
    """
    turning = guidance.command is not Command.LANE_FOLLOW
    value: float = score(v, yaw, turning, guidance.lateral, guidance.heading)
    return value
