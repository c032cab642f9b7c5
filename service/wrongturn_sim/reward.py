"""The paper's reward, for practice and training: r = (v* - |v* - v|) + 10 (1 - d) + 0.1 (15 - |a|)."""

import math
from typing import Final

from numba import njit

from wrongturn_networks.faults.fault import Guidance
from wrongturn_protocol import Command

CRUISING: Final = 35.0
"""Target speed v* outside a junction's window, km/h."""
TURNING: Final = 15.0
"""Target speed v* within the window, km/h."""
_KMH: Final = 3.6
_TURN: Final = 2.0 * math.pi
_DEGREES: Final = 180.0 / math.pi


@njit(cache=True)
def score_below(permitted: float, v: float, yaw: float, turning: bool, lateral: float, heading: float) -> float:
    """Return the reward where other road users permit no more than a speed: v* is at most that.

    Args:
        permitted: m/s; inf where nobody is in the way.
        v: speed, m/s; the formula converts it to km/h.
        yaw: heading of the car, radians.
        turning: whether the car is within a junction's window.
        lateral: distance of the car from its path, metres.
        heading: heading of that path, radians.
    """
    target = min(TURNING if turning else CRUISING, permitted * _KMH)
    angle = abs(yaw - heading) % _TURN
    angle = min(angle, _TURN - angle) * _DEGREES
    return (target - abs(target - v * _KMH)) + 10.0 * (1.0 - abs(lateral)) + 0.1 * (15.0 - angle)


@njit(cache=True)
def score(v: float, yaw: float, turning: bool, lateral: float, heading: float) -> float:
    """Return the reward by the formula.

    Args:
        v: speed, m/s; the formula converts it to km/h.
        yaw: heading of the car, radians.
        turning: whether the car is within a junction's window.
        lateral: distance of the car from its path, metres.
        heading: heading of that path, radians.
    """
    return score_below(math.inf, v, yaw, turning, lateral, heading)


def reward(v: float, yaw: float, guidance: Guidance) -> float:
    """Return the reward of this instant.

    Args:
        v: speed, m/s.
        yaw: heading of the car, radians.
        guidance: gives the window, the distance d from the route's path (m) and the angle a to it (degrees).
    """
    turning = guidance.command is not Command.LANE_FOLLOW
    value: float = score(v, yaw, turning, guidance.lateral, guidance.heading)
    return value
