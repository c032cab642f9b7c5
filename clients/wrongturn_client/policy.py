"""The agent's side of the contract: two calls, and nothing of ours to inherit from."""

from typing import Any, Protocol, runtime_checkable

from gymnasium import spaces

from wrongturn_protocol import Action
from wrongturn_protocol.observations import Observation


@runtime_checkable
class Policy(Protocol):
    """Any object with these two methods can be evaluated."""

    def reset(self, observation_space: spaces.Space[Any], /) -> None:
        """Forget the last episode; the next observations come from this space."""

    def act(self, observation: Observation, /) -> Action:
        """Decide on the next 0.1 s. The arrays of ``observation`` are not to be written to."""
