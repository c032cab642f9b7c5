"""The car: a kinematic bicycle with limits.

The state describes the body's centre; the bicycle turns about the middle of the rear axle. Integration is
semi-implicit Euler: steering and speed first, then the heading, then the position from the three new values. Scored
arithmetic is scalar and uses ``math`` without fastmath, so numba and Python give the same bits. ``motion.py`` of the
judge has the bicycle.
"""

from typing import Final

from wrongturn_judge.compiling import compiled
from wrongturn_judge.motion import curvature_of, moved
from wrongturn_protocol.vehicle import VEHICLE

SUB_STEP: Final = 0.05
"""Time step of the integration, seconds."""
SUB_STEPS: Final = 2
"""Sub-steps of a decision, which lasts 0.1 s."""

# Numba compiles global constants into the kernels, but not fields of a dataclass.
_SLEW: Final = VEHICLE.steering_slew
_ACCELERATION: Final = VEHICLE.acceleration
_BRAKING: Final = VEHICLE.braking
_DRAG: Final = VEHICLE.drag
_DRAG_SPEED: Final = VEHICLE.drag_speed
_MAX_SPEED: Final = VEHICLE.max_speed


State = tuple[float, float, float, float, float]
"""State of the car: x, y of the body's centre (metres), yaw (radians, counter-clockwise from east, in -pi..pi),
v (m/s, along the axis), steering (applied, -1 full left to 1 full right)."""


@compiled()
def advance(
    x: float, y: float, yaw: float, v: float, steering: float, steer: float, throttle: float, brake: float, dt: float
) -> State:
    """Return the car's state ``dt`` seconds later.

    The first five are the :data:`State` now; ``steer`` (-1..1), ``throttle`` and ``brake`` (0..1) are the action,
    already rounded to float32.
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
    # Drag never pushes a standing car backwards.
    v += (pull - (_DRAG + _DRAG_SPEED * v)) * dt
    if v < 0.0:
        v = 0.0
    elif v > _MAX_SPEED:
        v = _MAX_SPEED

    x, y, yaw = moved(x, y, yaw, v, curvature_of(steering, v), dt)
    return x, y, yaw, v, steering
