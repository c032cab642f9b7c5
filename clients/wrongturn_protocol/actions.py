"""Actions as agents give them: an :class:`Action`, or an array, a tuple or a list of three numbers."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wrongturn_protocol.episodes import Action

ActionLike = Action | NDArray[Any] | Sequence[float]
"""Steer, throttle and brake: an Action, or three numbers in that order."""


def three_numbers(action: object, error: type[Exception]) -> tuple[float, float, float]:
    """Return steer, throttle and brake of an :data:`ActionLike`, in any range; raise ``error`` for anything else."""
    try:
        given = np.asarray(action)
    except (RuntimeError, TypeError, ValueError) as cause:  # lists of different lengths, a tensor on a GPU
        raise error(f"action: {action!r} is not three numbers; give steer, throttle, brake ({cause})") from cause
    if given.dtype.kind not in "bfiu":
        raise error(f"action: {action!r} is not three numbers; give steer, throttle, brake")
    if given.shape != (3,):
        raise error(f"action: it has the shape {given.shape}; give three numbers: steer, throttle, brake")
    steer, throttle, brake = given.astype(np.float64).tolist()
    return steer, throttle, brake
