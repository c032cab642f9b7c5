"""Compensation for how a car answers: by how much its wheels turn, and how late its driver sees it.

A driver knows what it told the wheels, and sees their angle. So it can tell both. The arithmetic is that of NumPy and
of torch, so that an exported graph holds it too.
"""

from typing import Any, Final

from wrongturn_protocol.vehicle import DECISION_S, VEHICLE

_LAGS: Final = 21
MEMORY: Final = 3 * _LAGS + 1
"""Width of the memory. It begins with zeros. For each lag from 0 to 20 decisions it has the angle to which the wheels
were told to turn so long ago, and the sums of its products with the angle that is seen and with itself; at the end, the
sum of the squares of what is seen."""
_KEPT: Final = 0.98
"""Share of the sums that is left after a decision."""
_ALIKE: Final = 0.999
"""A shorter lag is believed if it explains this share of what the best explains."""
_ENOUGH: Final = 0.95
"""A gain is believed if it explains this share of what is seen."""
_LITTLE: Final = 1e-3
"""Up to this sum of squares the car has hardly steered, and neither gain nor lag is believed."""
_EXACT: Final = 0.03
"""A gain this near to 1 is 1."""
_GAINS: Final = (0.3, 2.0)
"""Least and greatest gain that is made up for."""
_LATE: Final = 4
"""From this lag on, in decisions, the car drives slowly."""
_CAUTIOUS: Final = 5.0
"""Above this speed it then does not accelerate, m/s."""
_SLEW: Final = VEHICLE.steering_slew * DECISION_S


def compensated(xp: Any, action: Any, steering: Any, speed: Any, memory: Any) -> tuple[Any, Any]:
    """Return the action that makes the car do what the driver asks for, (B, 3), and the new memory, (B, MEMORY).

    Where the wheels turn too little, it steers more; where they turn too much, less. If the driver sees 0.4 s late or
    more, the car does not accelerate above 5 m/s. If the car answers at once and as told, the action stays as it is, to
    the bit.

    Args:
        xp: ``numpy`` or ``torch``, whose arrays the others are, all float32.
        action: (B, 3) steer, throttle and brake that the driver asks for.
        steering: (B, 1) angle of the wheels that the driver sees, from -1 to 1.
        speed: (B, 1) m/s.
        memory: (B, MEMORY) of the last decision; zeros at the start.
    """
    told, products, squares = (memory[:, k * _LAGS : (k + 1) * _LAGS] for k in range(3))
    seen = _KEPT * memory[:, -1:] + steering * steering
    products = _KEPT * products + told * steering
    squares = _KEPT * squares + told * told
    some = xp.clip(squares, 1e-6, None)  # to divide by; the exporter drops a small number that is added
    # What was told at the true lag explains best what is seen. Wheels never turn the other way.
    explained = xp.clip(products, 0.0, None) ** 2 / some
    most = xp.amax(explained, -1, keepdims=True)
    lags = xp.arange(_LAGS, dtype=xp.float32)
    lag = xp.amin(xp.where(explained >= _ALIKE * most, lags, 1.0 * _LAGS), -1, keepdims=True)
    gain = ((products * (lags == lag)).sum(-1) / (some * (lags == lag)).sum(-1))[:, None]
    as_told = (xp.abs(gain - 1.0) < _EXACT) | (most <= _ENOUGH * seen) | (seen <= _LITTLE)
    steer = xp.clip(action[:, :1] / xp.clip(xp.where(as_told, 1.0, gain), *_GAINS), -1.0, 1.0)
    late = (lag >= _LATE) & (seen > _LITTLE)
    throttle = xp.where(late & (speed > _CAUTIOUS), 0.0, action[:, 1:2])
    wheels = told[:, :1] + xp.clip(steer - told[:, :1], -_SLEW, _SLEW)
    done = xp.concatenate([steer, throttle, action[:, 2:]], 1)
    return done, xp.concatenate([wheels, told[:, :-1], products, squares, seen], 1)
