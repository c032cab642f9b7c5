"""The paper's reward, for practice and training: r = (v* - |v* - v|) + 10 (1 - d) + 0.1 (15 - |a|)."""

import math
from typing import Final

from wrongturn_faults.rules import Guidance
from wrongturn_judge.compiling import compiled
from wrongturn_protocol import Command

CRUISING: Final = 35.0
"""Target speed v* outside a junction's window, km/h."""
TURNING: Final = 15.0
"""Target speed v* within the window, km/h."""
_KMH: Final = 3.6
_TURN: Final = 2.0 * math.pi
_DEGREES: Final = 180.0 / math.pi


@compiled()
def score_below(permitted: float, v: float, yaw: float, turning: bool, lateral: float, heading: float) -> float:
    """Return the reward where other road users permit no more than a speed (m/s, or inf): v* is at most that.

    ``v`` is m/s, which the formula converts to km/h; ``turning`` says whether the car is within a junction's window.
    ``yaw`` and the path's ``heading`` are radians, the distance from the path is ``lateral`` metres.
    """
    target = min(TURNING if turning else CRUISING, permitted * _KMH)
    angle = abs(yaw - heading) % _TURN
    angle = min(angle, _TURN - angle) * _DEGREES
    return (target - abs(target - v * _KMH)) + 10.0 * (1.0 - abs(lateral)) + 0.1 * (15.0 - angle)


def reward(v: float, yaw: float, guidance: Guidance) -> float:
    """Return the reward of this instant; speed in m/s, heading in radians, window and path as the guidance has them."""
    turning = guidance.command is not Command.LANE_FOLLOW
    return score_below(math.inf, v, yaw, turning, guidance.lateral, guidance.heading)
