"""Other actions: a list to choose from, or steering and one pedal."""

import operator
from collections.abc import Iterable
from typing import Any, Final, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import TransformAction
from numpy.typing import NDArray

from wrongturn_protocol.observations import action_space, in_short

DEFAULT_ACTIONS: Final = tuple(
    (steer, throttle, brake)
    for steer in (-0.6, -0.2, 0.0, 0.2, 0.6)
    for throttle, brake in ((0.5, 0.0), (0.0, 0.0), (0.0, 0.5))
)
"""Five positions of the wheel, left first, each with gas, with no pedal, and with the brake."""


class DiscreteActions(TransformAction[Any, Any, Any], RecordConstructorArgs):
    """Choose the action from a list, for algorithms such as DQN: the space is ``Discrete(len(actions))``.

    Args:
        actions: The list, (n, 3): steer in [-1, 1], throttle and brake in [0, 1]. By default 15 actions.

    Raises:
        ValueError: An action is not three numbers in their ranges, or there is none.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], actions: Iterable[Iterable[float]] = DEFAULT_ACTIONS) -> None:
        try:
            given = [tuple(action) for action in actions]
        except TypeError:
            raise ValueError(
                f"actions: {actions!r} is no list of actions; give rows of steer, throttle, brake"
            ) from None
        RecordConstructorArgs.__init__(self, actions=given)
        _needs_three_controls(env, self)
        self.actions: Final[NDArray[np.float32]] = _checked(given)
        """The list, float32 (n, 3)."""
        TransformAction.__init__(self, env, self._chosen, spaces.Discrete(len(self.actions)))

    def _chosen(self, action: object) -> NDArray[np.float32]:
        try:
            index = operator.index(cast(Any, np.asarray(action).item()))
        except (TypeError, ValueError):
            index = -1
        if not 0 <= index < len(self.actions):
            raise ValueError(f"action: {action!r} is not a position in the list; give 0 to {len(self.actions) - 1}")
        return np.array(self.actions[index], np.float32)


class SteerAndPedal(TransformAction[Any, Any, Any], RecordConstructorArgs):
    """Steer, and press one pedal: two numbers from -1 to 1, the range that suits many algorithms.

    The first is steer. The second is throttle where it is positive, and brake where it is negative.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        _needs_three_controls(env, self)
        TransformAction.__init__(self, env, self._controls, spaces.Box(-1.0, 1.0, (2,), np.float32))

    @staticmethod
    def _controls(action: object) -> NDArray[np.float32]:
        try:
            steer, pedal = np.asarray(action, np.float32).tolist()
            return np.array([steer, max(pedal, 0.0), max(-pedal, 0.0)], np.float32)
        except (TypeError, ValueError):
            raise ValueError(f"action: {action!r} is not two numbers; give steer and pedal") from None


def _needs_three_controls(env: gymnasium.Env[Any, Any], wrapper: object) -> None:
    if env.action_space != action_space():
        raise ValueError(
            f"{type(wrapper).__name__}: actions of this environment are {in_short(env.action_space)}, not "
            "steer, throttle and brake; wrap it before other wrappers of actions"
        )


def _checked(actions: list[tuple[float, ...]]) -> NDArray[np.float32]:
    if not actions:
        raise ValueError("actions: the list is empty; give at least one of steer, throttle, brake")
    space = action_space()
    for number, action in enumerate(actions):
        try:
            row = np.array(action, np.float32)
        except (TypeError, ValueError):
            row = np.array([], np.float32)
        if not space.contains(row):
            raise ValueError(
                f"actions[{number}]: {action!r} is not steer in [-1, 1], throttle in [0, 1] and brake in [0, 1]"
            )
    return np.array(actions, np.float32)
