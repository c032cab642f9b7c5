"""Speed at which a car can still stop behind the road users in its way."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_agents.baselines.path import Path

_CLEARANCE: Final = 0.4  # metres that must be free on either side of the body
_STAND: Final = 2.5  # metres between the bumpers when the car stands behind another
_SIGHT: Final = 50.0  # metres along the path; road users further away do not matter
_FORESIGHT: Final = (0.0, 0.7, 1.4)  # seconds ahead at which a road user may be in the way, at its present speed


def speed_behind(
    path: Path, here: float, road_users: NDArray[np.floating], *, nose: float, half_width: float, braking: float
) -> float:
    """Return the speed from which a car can stop behind the road users in its way, m/s; infinite if there are none.

    Args:
        path: The path that the car follows.
        here: Position of the car, metres along the path.
        road_users: Others, (N, 6): x, y, yaw, length, width, speed; metres, radians, m/s.
        nose: Distance from the car's centre to its front bumper, metres.
        half_width: Half the width of the car, metres.
        braking: Deceleration of the car, m/s2.
    """
    limit = math.inf
    for x, y, yaw, length, width, speed in road_users.tolist():
        for seconds in _FORESIGHT if speed > 0.1 else _FORESIGHT[:1]:
            there_x = x + seconds * speed * math.cos(yaw)
            there_y = y + seconds * speed * math.sin(yaw)
            along = path.project(there_x, there_y)
            if not 0.0 < along - here < _SIGHT:
                continue
            on_x, on_y = path.at(along)
            ahead_x, ahead_y = path.at(along + 0.5)
            turned = yaw - math.atan2(ahead_y - on_y, ahead_x - on_x)
            across = abs(length * math.sin(turned)) / 2 + abs(width * math.cos(turned)) / 2
            if math.hypot(there_x - on_x, there_y - on_y) > half_width + across + _CLEARANCE:
                continue
            reach = abs(length * math.cos(turned)) / 2 + abs(width * math.sin(turned)) / 2
            gap = along - here - reach - nose - _STAND
            away = max(0.0, speed * math.cos(turned))
            limit = min(limit, math.sqrt(max(0.0, 2.0 * braking * gap + away * away)))
    return limit
