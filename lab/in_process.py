"""Drive any agent through given trials in this process, many side by side, and keep what it drove."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from wrongturn_agents.agent import Agent
from wrongturn_agents.registry import AgentSource
from wrongturn_client.episode_calls import action_of
from wrongturn_networks import Town, load_town
from wrongturn_protocol import Outcome, Trial
from wrongturn_protocol.observations import Observation
from wrongturn_sim import FleetTraffic, Trajectory, WrongturnVectorEnv

_BRAKE = (0.0, 0.0, 1.0)
_PER_SECOND = 10
"""Decisions in a second."""
_CARS = 24
"""Cars side by side. More of them share each call's cost, but wait longer for the last one."""


class DrivenEpisode(NamedTuple):
    """A trial, and what an agent did in it."""

    trial: Trial
    trajectory: Trajectory
    outcome: Outcome | None
    """None if the drive was over before there was a verdict."""


def drive_in_process(
    source: AgentSource,
    trials: Sequence[Trial],
    *,
    drive_on: float | None = None,
    enough: Callable[[Trajectory], bool] | None = None,
    threads: int = 1,
    progress: Callable[[int, int], None] = lambda _finished, _total: None,
) -> Iterator[DrivenEpisode]:
    """Drive each trial once, and yield the episodes as they end.

    Args:
        source: the agent. One that keeps memory is made anew for each car.
        trials: trials in any towns. Those with other road users drive beside the batch's own traffic, not SUMO's.
        drive_on: seconds to drive each trial for, whatever the verdict; None ends each drive with its verdict.
        enough: called with what a car has driven so far, once a second; True ends its drive before ``drive_on``.
        threads: threads that share the simulation and an agent without memory.
        progress: called with the numbers of finished and of all trials.
    """
    finished = 0
    progress(finished, len(trials))
    with ThreadPoolExecutor(threads) as pool:
        by_town: dict[tuple[str, int | None], list[Trial]] = {}
        for trial in trials:
            by_town.setdefault((trial.town, trial.scenery), []).append(trial)
        for place, group in by_town.items():
            for episode in _in_town(source, load_town(*place), group, drive_on, enough, threads, pool):
                finished += 1
                progress(finished, len(trials))
                yield episode


def _in_town(
    source: AgentSource,
    town: Town,
    waiting: list[Trial],
    drive_on: float | None,
    enough: Callable[[Trajectory], bool] | None,
    threads: int,
    pool: ThreadPoolExecutor,
) -> Iterator[DrivenEpisode]:
    count = min(_CARS, len(waiting))
    envs = WrongturnVectorEnv(
        count,
        town,
        source.track,
        threads=threads,
        drive_on=drive_on,
        own_traffic=FleetTraffic(),
        autoreset_mode=AutoresetMode.DISABLED,
    )
    agents = _agents(source, count)
    current = [waiting.pop(0) for _ in range(count)]
    counts = [True] * count  # whether the car's drive is one of those asked for
    for agent in agents:
        agent.reset(envs.single_observation_space)
    observation, _ = envs.reset(seed=0, options={"trial": current})
    try:
        while any(counts):
            observation, _, terminated, truncated, _ = envs.step(_actions(agents, observation, counts, pool))
            over = terminated | truncated
            for k in range(count):
                asked = enough is not None and counts[k] and envs.steps[k] % _PER_SECOND == 0
                record = envs.episode(k) if counts[k] and (over[k] or asked) else None
                if record is not None and (over[k] or (enough is not None and enough(record.trajectory))):
                    over[k] = True
                    yield DrivenEpisode(current[k], record.trajectory, record.outcome)
                if over[k]:
                    # All cars step together. A car without a trial repeats its last one, which does not count.
                    counts[k] = bool(waiting)
                    current[k] = waiting.pop(0) if waiting else current[k]
                    agents[k].reset(envs.single_observation_space)
            if over.any() and any(counts):
                observation, _ = envs.reset(options={"trial": current, "reset_mask": over})
    finally:
        envs.close()


def _agents(source: AgentSource, count: int) -> list[Agent]:
    """Return an agent for each car; one without memory drives them all."""
    first = source.make()
    if getattr(first, "memoryless", False):
        return [first] * count
    return [first, *(source.make() for _ in range(count - 1))]


def _actions(
    agents: Sequence[Agent], observation: Observation, counts: Sequence[bool], pool: ThreadPoolExecutor
) -> NDArray[np.float32]:
    """Return each car's action, (n, 3); a car whose drive does not count brakes."""

    def act(k: int) -> tuple[float, float, float]:
        if not counts[k]:
            return _BRAKE
        action = action_of(agents[k].act({name: array[k] for name, array in observation.items()}))
        return action.steer, action.throttle, action.brake

    cars = range(len(agents))
    shared = getattr(agents[0], "memoryless", False)
    return np.array(list(pool.map(act, cars) if shared else map(act, cars)), np.float32)
