"""What an agent is: two calls, and a few words about itself."""

from typing import Any, Protocol, runtime_checkable

from gymnasium import spaces

from wrongturn_protocol import Action, AgentKind, Track
from wrongturn_protocol.observations import Observation


@runtime_checkable
class Agent(Protocol):
    """A driver that can be put on a suite: any object with these two methods will do.

    What a class says of itself is read from its class attributes:

    ==============  ==================================================================================
    ``track``       the track whose observations it wants, a :class:`Track` or its name; required
    ``name``        how it appears on the leaderboard; by default the class's name
    ``kind``        an :class:`AgentKind`; by default ``submitted``
    ``description`` one sentence for the leaderboard; by default the docstring's first line
    ``memoryless``  True where an action depends on nothing but the observation, and ``act`` may be called in several
                    threads at a time: episodes are then driven side by side
    ==============  ==================================================================================

    The class is made without arguments, once for a whole evaluation. An agent may keep a memory within an episode and
    must forget it in :meth:`reset`, since trials come in a secret order.
    """

    def reset(self, observation_space: spaces.Space[Any]) -> None:
        """Begin a new episode.

        Args:
            observation_space: The flat ``Dict`` of the agent's track, see ``wrongturn_protocol.observations``.
        """

    def act(self, observation: Observation) -> Action:
        """Decide for the next 0.1 s.

        Args:
            observation: One array for each key of the space.

        Returns:
            Steer in [-1, 1] (left negative), throttle and brake each in [0, 1].
        """
        ...


def track_of_agent(agent: Any) -> Track | None:
    """The track that an agent, or its class, says it wants; None where it names none or one that does not exist."""
    try:
        return Track(str(getattr(agent, "track", "")))
    except ValueError:
        return None


def kind_of_agent(agent: Any) -> AgentKind:
    """The kind that an agent, or its class, says it is of; ``submitted`` where it says nothing that is known."""
    try:
        return AgentKind(str(getattr(agent, "kind", AgentKind.SUBMITTED)))
    except ValueError:
        return AgentKind.SUBMITTED
