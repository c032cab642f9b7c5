"""A reward of your own, made from what a step returns."""

import math
from collections.abc import Callable, Mapping
from typing import Any, SupportsFloat

import gymnasium
from gymnasium.utils import RecordConstructorArgs

Shape = Callable[[float, Any, Mapping[str, Any]], SupportsFloat]


class ShapeReward(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Replace the reward by a function of it, of the observation and of ``info``.

    Gymnasium's ``TransformReward`` gives its function the reward alone. At an episode's end, ``info["verdict"]`` says
    how it ended. The observation is the one that the wrapped environment gives. Rewards never change a verdict.

    Args:
        function: Called after each step with the reward, the observation and ``info``; returns the new reward.

    Raises:
        ValueError: On a step, if the function does not return a finite number.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], function: Shape) -> None:
        RecordConstructorArgs.__init__(self, function=function)
        gymnasium.Wrapper.__init__(self, env)
        if not callable(function):
            raise ValueError(f"function: {function!r} is no function; give a function of reward, observation and info")
        self.function = function

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Drive on, and shape the reward."""
        seen, reward, terminated, truncated, info = self.env.step(action)
        made: object = self.function(float(reward), seen, info)
        try:
            shaped = float(made)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            shaped = math.nan
        if not math.isfinite(shaped):
            raise ValueError(f"function: returned {made!r} as the reward; return a finite number")
        return seen, shaped, terminated, truncated, info
