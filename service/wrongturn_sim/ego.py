"""The car: a kinematic bicycle with limits.

The state is that of the body's centre; the bicycle turns about the middle of the rear axle. Integrated by
semi-implicit Euler: steering and speed first, then the heading, then the position with all three new. Scored
arithmetic is scalar, in ``math`` alone and without fastmath, so that numba and Python give the same bits.
"""

import math
from dataclasses import dataclass
from typing import Final

from numba import njit


@dataclass(frozen=True)
class Vehicle:
    """The car's dimensions and limits, in metres, seconds and radians."""

    wheelbase: float = 2.9
    length: float = 4.6
    width: float = 1.9
    rear_axle: float = 1.45
    """From the rear axle forward to the body's centre."""
    half_track: float = 0.8
    """From the axis to the wheels on either side."""
    max_wheel_angle: float = math.radians(35.0)
    """Of the front wheels, at steering 1."""
    steering_slew: float = 2.0
    """How fast the steering moves within -1..1, per second."""
    acceleration: float = 3.5
    """At full throttle, m/s2."""
    braking: float = 8.0
    """At full brake, m/s2; any brake shuts the throttle."""
    drag: float = 0.15
    """m/s2, of a car that moves."""
    drag_speed: float = 0.01
    """Further drag in proportion to the speed, 1/s."""
    grip: float = 7.0
    """Most lateral acceleration, m/s2: beyond it the car runs wide."""
    max_speed: float = 22.0
    """m/s; there is no reverse."""

    @property
    def half_length(self) -> float:
        """From the centre to either bumper."""
        return self.length / 2

    @property
    def half_width(self) -> float:
        """From the axis to either side."""
        return self.width / 2


VEHICLE: Final = Vehicle()
SUB_STEP: Final = 0.05
"""Seconds that the car is integrated over at a time."""
SUB_STEPS: Final = 2
"""Sub-steps of a decision."""

# Kernels take their constants from globals, which numba compiles in.
_WHEELBASE: Final = VEHICLE.wheelbase
_REAR_AXLE: Final = VEHICLE.rear_axle
_MAX_WHEEL_ANGLE: Final = VEHICLE.max_wheel_angle
_SLEW: Final = VEHICLE.steering_slew
_ACCELERATION: Final = VEHICLE.acceleration
_BRAKING: Final = VEHICLE.braking
_DRAG: Final = VEHICLE.drag
_DRAG_SPEED: Final = VEHICLE.drag_speed
_GRIP: Final = VEHICLE.grip
_MAX_SPEED: Final = VEHICLE.max_speed
_TURN: Final = 2.0 * math.pi


State = tuple[float, float, float, float, float]
"""Where the body's centre is and how the car moves: x, y (metres), yaw (radians, counter-clockwise from east, in
-pi..pi), v (m/s, along the axis), steering (applied, -1 full left to 1 full right)."""


@njit(cache=True)
def advance(
    x: float,
    y: float,
    yaw: float,
    v: float,
    steering: float,
    steer: float,
    throttle: float,
    brake: float,
    dt: float,
) -> State:
    """The car's next state, ``dt`` seconds later.

    Args:
        x: of the body's centre, metres.
        y: of the body's centre, metres.
        yaw: radians, counter-clockwise from east.
        v: m/s.
        steering: applied so far, -1..1.
        steer: asked for, -1..1, already rounded to float32.
        throttle: 0..1, already rounded to float32.
        brake: 0..1, already rounded to float32.
        dt: seconds.

    Returns:
        x, y, yaw, v, steering.
    """
    reach = _SLEW * dt
    turn = steer - steering
    if turn > reach:
        steering += reach
    elif turn < -reach:
        steering -= reach
    else:
        steering = steer

    pull = -_BRAKING * brake if brake > 0.0 else _ACCELERATION * throttle
    # Drag never pushes a standing car back: the speed ends at nought.
    v += (pull - (_DRAG + _DRAG_SPEED * v)) * dt
    if v < 0.0:
        v = 0.0
    elif v > _MAX_SPEED:
        v = _MAX_SPEED

    # Steering right is positive and turns the yaw, counter-clockwise, down.
    curvature = math.tan(-steering * _MAX_WHEEL_ANGLE) / _WHEELBASE
    square = v * v
    if curvature * square > _GRIP:
        curvature = _GRIP / square
    elif curvature * square < -_GRIP:
        curvature = -_GRIP / square

    rear_x = x - _REAR_AXLE * math.cos(yaw)
    rear_y = y - _REAR_AXLE * math.sin(yaw)
    yaw += v * curvature * dt
    if yaw > math.pi:
        yaw -= _TURN
    elif yaw < -math.pi:
        yaw += _TURN
    ahead = v * dt + _REAR_AXLE
    return rear_x + ahead * math.cos(yaw), rear_y + ahead * math.sin(yaw), yaw, v, steering
