"""What a worker does: it drives a group of trials with one agent, which it loads once."""

import sys
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from wrongturn_agents.registry import resolve
from wrongturn_agents.results_file import TrialResult
from wrongturn_agents.worker import GuardedAgent
from wrongturn_protocol import Sight, Trial
from wrongturn_protocol.observations import Observation, observation_space
from wrongturn_sim.episode import Episode

TOGETHER: Final = 8
"""Episodes that a worker holds open at once for an agent with ``act_batch``."""


@dataclass(frozen=True)
class Group:
    """Trials that a worker drives with one agent. What they come to does not depend on how trials are grouped."""

    run: int
    """Number of the run that they belong to."""
    agent: str
    """The agent, as :func:`wrongturn_agents.registry.resolve` takes it."""
    folder: str
    """Working directory of the command, where a class of the user's is found."""
    trials: tuple[Trial, ...]


def drive_group(group: Group) -> dict[str, TrialResult]:
    """Drive the trials of a group and return their results by id.

    Raises:
        AgentsError: The agent cannot be loaded, or fails.
        SimError: The simulation fails.
        NetworkError: A drawn town cannot be built.
    """
    agent, sight = loaded(group.agent, group.folder)
    # This process has one simulation of SUMO, so trials with other road users are driven one by one.
    crowded = [trial for trial in group.trials if trial.traffic.vehicles or trial.traffic.pedestrians]
    alone = [trial for trial in group.trials if trial not in crowded]
    episodes = [*_driven(agent, sight, alone, TOGETHER if agent.takes_batches else 1)]
    episodes += _driven(agent, sight, crowded, 1)
    return {one.trial.id: TrialResult.of(one.outcome, one.trajectory.sha256) for one in episodes if one.outcome}


@lru_cache(maxsize=4)
def loaded(agent: str, folder: str) -> tuple[GuardedAgent, Sight]:
    """Load an agent, once in a process; classes of the user's are found in the folder. Raises AgentsError."""
    if folder not in sys.path:
        sys.path.insert(0, folder)
    source = resolve(agent)
    return GuardedAgent(source.name, source.make()), source.sight


def _driven(agent: GuardedAgent, sight: Sight, trials: Iterable[Trial], together: int) -> Iterator[Episode]:
    """Drive the trials, so many of them side by side, and yield the episodes as they end."""
    waiting, space = deque(trials), observation_space(sight)
    driving: list[tuple[Episode, Observation]] = []
    while waiting or driving:
        while waiting and len(driving) < together:
            episode = Episode(waiting.popleft(), sight)
            seen = episode.reset()
            agent.reset(space)
            driving.append((episode, seen))
        observations = [seen for _, seen in driving]
        actions = agent.act_batch(observations) if together > 1 else [agent.act(observations[0])]
        going = []
        for (episode, _), action in zip(driving, actions, strict=True):
            step = episode.step(action.steer, action.throttle, action.brake)
            if step.terminated or step.truncated:
                yield episode
            else:
                going.append((episode, step.observation))
        driving = going
