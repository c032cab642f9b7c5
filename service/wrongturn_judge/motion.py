"""How the car moves: the kinematic bicycle, which the simulation drives and the judge extends by a second.

Scored arithmetic is scalar and uses ``math`` without fastmath, so numba and Python give the same bits.
"""

import math
from typing import Final

from wrongturn_judge.compiling import compiled
from wrongturn_protocol.vehicle import VEHICLE

# Numba compiles global constants into the kernels, but not fields of a dataclass.
_WHEELBASE: Final = VEHICLE.wheelbase
_REAR_AXLE: Final = VEHICLE.rear_axle
_MAX_WHEEL_ANGLE: Final = VEHICLE.max_wheel_angle
_GRIP: Final = VEHICLE.grip
_TURN: Final = 2.0 * math.pi


@compiled()
def curvature_of(steering: float, v: float) -> float:
    """Return the curvature of the rear axle's path, 1/m, positive to the left.

    ``steering`` is the applied one, positive to the right; ``v`` is in m/s. A car that is too fast runs wide.
    """
    curvature = math.tan(-steering * _MAX_WHEEL_ANGLE) / _WHEELBASE
    square = v * v
    if curvature * square > _GRIP:
        return _GRIP / square
    if curvature * square < -_GRIP:
        return -_GRIP / square
    return curvature


@compiled()
def moved(x: float, y: float, yaw: float, v: float, curvature: float, dt: float) -> tuple[float, float, float]:
    """Return place and heading of the body's centre ``dt`` seconds later; metres, radians in -pi..pi, m/s, 1/m."""
    rear_x = x - _REAR_AXLE * math.cos(yaw)
    rear_y = y - _REAR_AXLE * math.sin(yaw)
    yaw += v * curvature * dt
    if yaw > math.pi:
        yaw -= _TURN
    elif yaw < -math.pi:
        yaw += _TURN
    ahead = v * dt + _REAR_AXLE
    return rear_x + ahead * math.cos(yaw), rear_y + ahead * math.sin(yaw), yaw


@compiled()
def turn_between(before: float, after: float) -> float:
    """Return by how much a heading changed, radians in -pi..pi."""
    turn = after - before
    return turn - _TURN * math.floor((turn + math.pi) / _TURN)
