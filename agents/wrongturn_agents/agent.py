"""The interface of an agent: two methods, and class attributes that describe it."""

from typing import Any, Protocol, runtime_checkable

import numpy as np
from gymnasium import spaces

from wrongturn_protocol import ActionLike, AgentKind, Command, Sight, Track
from wrongturn_protocol.observations import Observation, observation_space, sentence_of


@runtime_checkable
class Agent(Protocol):
    """A driver for a suite: any object with these two methods.

    Class attributes describe the agent:

    =====================  ===========================================================================================
    ``track``              track of the observations that it takes, a :class:`Track` or its name; required
    ``rig``                a :class:`Rig`, for other cameras, navigation inputs, rate or answers than the track's
    ``name``               name on the leaderboard; by default the class's name
    ``kind``               an :class:`AgentKind`; by default ``submitted``
    ``description``        one sentence for the leaderboard; by default the first line of the docstring
    ``memoryless``         True if an action depends on the observation alone and several threads may call ``act``
                           at once; episodes then run side by side
    ``trained_on_faults``  True if it met wrong commands in its training; the leaderboard marks it
    =====================  ===========================================================================================

    A memoryless agent may also have ``act_batch(observations)``. ``wrongturn run --workers`` and ``--ray`` call it in
    place of ``act``, with the observations of all episodes that a worker holds open. Each array then has a batch axis
    (n, …) in front, and it returns n actions, such as an array (n, 3). Each has to be what ``act`` gives for that
    observation, to the last bit: an action must not depend on what else is in the batch (``docs/decisions.md``, 12).

    The class is created without arguments, once for an evaluation. An agent may remember things within an episode. It
    must forget them in :meth:`reset`, because trials come in a secret order.
    """

    def reset(self, observation_space: spaces.Space[Any]) -> None:
        """Begin a new episode.

        Args:
            observation_space: Flat ``Dict`` of the agent's track; see ``wrongturn_protocol.observations``.
        """

    def act(self, observation: Observation) -> ActionLike:
        """Return the action until the next decision.

        Args:
            observation: One array for each key of the space.

        Returns:
            Steer in [-1, 1] (left is negative); throttle and brake, each in [0, 1]: an Action, or three numbers in an
            array, a tuple or a list. An agent with a rig may answer with what its rig says.
        """
        ...


def try_out(agent: Agent, sight: Sight) -> None:
    """Let an agent drive one step on a made-up observation, the same each time, so that it fails before a run begins.

    Raises what the agent raises.
    """
    space = observation_space(sight)
    space.seed(0)
    agent.reset(space)
    command = np.array([Command.LANE_FOLLOW], np.int64)
    seen = {**space.sample(), "command": command, "next_command": command, "sentence": sentence_of("Follow the road.")}
    agent.act({name: seen[name] for name in space})
    agent.reset(space)


def track_of_agent(agent: Any) -> Track | None:
    """Return the track that an agent or its class names; None if it names none or one that does not exist."""
    try:
        return Track(str(getattr(agent, "track", "")))
    except ValueError:
        return None


def kind_of_agent(agent: Any) -> AgentKind:
    """Return the kind that an agent or its class names; ``submitted`` if it names none or an unknown one."""
    try:
        return AgentKind(str(getattr(agent, "kind", AgentKind.SUBMITTED)))
    except ValueError:
        return AgentKind.SUBMITTED
