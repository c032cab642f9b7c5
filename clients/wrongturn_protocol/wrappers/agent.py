"""An agent that was trained behind wrappers, for evaluations."""

from collections.abc import Callable, Iterator
from typing import Any, SupportsFloat

import gymnasium
from gymnasium import spaces
from gymnasium.wrappers import StickyAction

from wrongturn_protocol.observations import Observation, action_space

Wrap = Callable[[gymnasium.Env[Any, Any]], gymnasium.Env[Any, Any]]


class WrappedAgent:
    """Drive an evaluation with a policy that was trained behind wrappers.

    The service sends plain observations and takes plain actions. This agent puts the same wrappers between it and the
    policy. Example: ``client.evaluate(WrappedAgent(policy, wrap), suite)``.

    Wrappers that repeat or skip steps, such as ``RepeatAction``, do not fit, because the service wants an action for
    each observation. ``StickyAction`` does not fit, because it changes actions at random.

    Args:
        policy: Called with a wrapped observation; returns an action for the wrapped environment. With
            Stable-Baselines3: ``lambda seen: model.predict(seen, deterministic=True)[0]``.
        wrap: The wrappers of the training, as a function: ``lambda env: SteerAndPedal(GrayPicture(env))``.
    """

    def __init__(self, policy: Callable[[Any], Any], wrap: Wrap) -> None:
        self._policy, self._wrap = policy, wrap
        self._relay: _Relay | None = None
        self._env: gymnasium.Env[Any, Any] | None = None
        self._chosen: Any = None

    def reset(self, observation_space: spaces.Space[Any]) -> None:
        """Begin an episode: make the wrappers anew.

        Raises:
            ValueError: A wrapper does not fit these observations, or is ``StickyAction``.
        """
        self._relay = _Relay(observation_space)
        self._env = self._wrap(self._relay)
        if any(isinstance(layer, StickyAction) for layer in _layers(self._env)):
            raise ValueError("wrap: StickyAction changes actions at random; leave it out of evaluations")
        self._chosen = None

    def act(self, observation: Observation) -> Any:
        """Return the plain action, float32 (3,): steer, throttle, brake.

        Raises:
            ValueError: ``reset`` was not called, or a wrapper drives more than one step for an action.
        """
        if self._relay is None or self._env is None:
            raise ValueError("act before the first reset; call reset")
        first = self._chosen is None
        self._relay.incoming = observation
        seen = self._env.reset()[0] if first else self._env.step(self._chosen)[0]
        if self._relay.incoming is not None:
            raise ValueError("wrap: a wrapper takes no observation from the environment; leave it out")
        self._chosen = self._policy(seen)
        return _plain(self._env, self._chosen)


class _Relay(gymnasium.Env[Any, Any]):
    """Hands the service's observations to the wrappers, one for each reset and step."""

    def __init__(self, observation_space: spaces.Space[Any]) -> None:
        self.observation_space = observation_space
        self.action_space = action_space()
        self.incoming: Observation | None = None

    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002
    ) -> tuple[Observation, dict[str, Any]]:
        super().reset(seed=seed)
        return self._taken(), {}

    def step(
        self,
        action: Any,  # noqa: ARG002 - the policy's choice went to the service
    ) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        return self._taken(), 0.0, False, False, {}

    def _taken(self) -> Observation:
        seen, self.incoming = self.incoming, None
        if seen is None:
            raise ValueError("wrap: a wrapper drives more than one step for an action; leave it out")
        return seen


def _plain(env: gymnasium.Env[Any, Any], action: Any) -> Any:
    """Take an action through the wrappers of actions, outermost first."""
    for layer in _layers(env):
        if isinstance(layer, gymnasium.ActionWrapper):
            action = layer.action(action)
    return action


def _layers(env: gymnasium.Env[Any, Any]) -> Iterator[gymnasium.Wrapper[Any, Any, Any, Any]]:
    """Yield the wrappers, outermost first."""
    while isinstance(env, gymnasium.Wrapper):
        yield env
        env = env.env
