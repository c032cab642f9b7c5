"""The policies' actions, steer and accelerate, and the car's controls made from them."""

from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

ACTION_SPACE: Final = spaces.Box(-1.0, 1.0, (2,), np.float32)
"""(2,): steer, from -1 (full left) to 1 (full right); accelerate, from 1 (full throttle) to -1 (full brake)."""


def controls(actions: NDArray[Any]) -> NDArray[np.float32]:
    """Turn steer and accelerate, (..., 2), into steer, throttle and brake, (..., 3).

    Values out of range are clipped, because a Gaussian policy has no bounds.
    """
    clipped = np.clip(np.asarray(actions, np.float32), -1.0, 1.0)
    accelerate = clipped[..., 1]
    return np.stack([clipped[..., 0], np.maximum(accelerate, 0.0), np.maximum(-accelerate, 0.0)], -1)
