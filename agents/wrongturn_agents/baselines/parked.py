"""Baseline ``parked``: never drives."""

from typing import Any, ClassVar

from gymnasium import spaces

from wrongturn_protocol import Action, AgentKind, Track
from wrongturn_protocol.observations import Observation


class Parked:
    """Brakes at once and stays there. It is never unsafe and never engaged, so it is not ranked."""

    name: ClassVar[str] = "parked"
    track: ClassVar[Track] = Track.PRIVILEGED
    kind: ClassVar[AgentKind] = AgentKind.BASELINE
    description: ClassVar[str] = "Brakes at once and stands; shows that standing still earns no rank."

    def reset(self, observation_space: spaces.Space[Any]) -> None:
        """Do nothing, because there is nothing to forget."""

    def act(self, observation: Observation) -> Action:  # noqa: ARG002
        """Return full brake."""
        return Action(steer=0.0, throttle=0.0, brake=1.0)
