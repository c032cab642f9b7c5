"""What an agent has to offer: two methods, and no base class."""

import reprlib
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

from gymnasium import spaces

from wrongturn_protocol import Action as Action  # noqa: PLC0414 - public in wrongturn_client too
from wrongturn_protocol import ActionLike
from wrongturn_protocol import Tracker as Tracker  # noqa: PLC0414
from wrongturn_protocol import TrackerGains as TrackerGains  # noqa: PLC0414
from wrongturn_protocol.observations import Observation


@runtime_checkable
class Policy(Protocol):
    """Any object with these two methods can be evaluated."""

    def reset(self, observation_space: spaces.Space[Any], /) -> None:
        """Begin an episode, whose observations come from this space; forget the last one."""

    def act(self, observation: Observation, /) -> ActionLike:
        """Return the action for the next 0.1 s: an Action, or steer, throttle and brake as an array, tuple or list."""


PolicyMaker = Callable[[], Policy]
"""Makes a policy for one episode, such as a class. Episodes driven at the same time then share no memory."""


def maker_of(policy: Policy | PolicyMaker) -> PolicyMaker:
    """Return what gives each episode its policy: the maker itself, or one that always gives the same policy."""
    if not isinstance(policy, Policy) and not callable(policy):
        raise TypeError(
            f"policy: is {reprlib.repr(policy)}; give an object with reset and act, or a function that makes one"
        )
    if isinstance(policy, type) or not isinstance(policy, Policy):
        return policy
    return lambda: policy
