"""The policies' actions, steer and accelerate, and the car's controls made from them."""

from typing import Any, Final

import gymnasium
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


class SteerAccelerate(gymnasium.ActionWrapper[Any, NDArray[np.float32], NDArray[np.float32]]):
    """Wrapper of a single environment that takes steer and accelerate, like the policies' environments."""

    def __init__(self, env: gymnasium.Env[Any, NDArray[np.float32]]) -> None:
        super().__init__(env)
        self.action_space = ACTION_SPACE

    def action(self, action: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return steer, throttle and brake, (3,)."""
        return controls(action)
