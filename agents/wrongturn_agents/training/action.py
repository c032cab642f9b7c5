"""What the policies act by, steer and accelerate, and what that is for the car."""

from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

ACTION_SPACE: Final = spaces.Box(-1.0, 1.0, (2,), np.float32)
"""(2,): steer, -1 full left to 1 full right; accelerate, 1 full throttle to -1 full brake."""


def controls(actions: NDArray[Any]) -> NDArray[np.float32]:
    """Steer, throttle and brake, (..., 3), of steer and accelerate, (..., 2).

    What is out of range is taken to its border: a Gaussian policy knows none.
    """
    clipped = np.clip(np.asarray(actions, np.float32), -1.0, 1.0)
    accelerate = clipped[..., 1]
    return np.stack([clipped[..., 0], np.maximum(accelerate, 0.0), np.maximum(-accelerate, 0.0)], -1)


class SteerAccelerate(gymnasium.ActionWrapper[Any, NDArray[np.float32], NDArray[np.float32]]):
    """A single environment that is driven as the policies drive: by steer and accelerate."""

    def __init__(self, env: gymnasium.Env[Any, NDArray[np.float32]]) -> None:
        super().__init__(env)
        self.action_space = ACTION_SPACE

    def action(self, action: NDArray[np.float32]) -> NDArray[np.float32]:
        """Steer, throttle and brake, (3,)."""
        return controls(action)
