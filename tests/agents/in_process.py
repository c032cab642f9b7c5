"""Drives a whole suite in this process, without the service."""

from collections import Counter
from functools import cache

from wrongturn_agents import Agent
from wrongturn_networks import load_suite
from wrongturn_protocol import Outcome, Track, Trial, Verdict
from wrongturn_protocol.observations import observation_space
from wrongturn_sim import Episode, Simulator

Results = dict[str, tuple[Trial, Outcome]]


@cache
def _simulator() -> Simulator:
    return Simulator()


def drive(agent: Agent, trial: Trial) -> Outcome:
    """Drive one episode to its end and return its outcome."""
    episode = Episode(trial, Track.PRIVILEGED, simulator=_simulator())
    observation = episode.reset()
    agent.reset(observation_space(Track.PRIVILEGED))
    while episode.outcome is None:
        action = agent.act(observation)
        observation = episode.step(action.steer, action.throttle, action.brake).observation
    return episode.outcome


def drive_suite(agent: Agent, suite: str = "wrong-command@2") -> Results:
    """Drive all of a suite's trials and twins, and return trials and outcomes by id."""
    return {trial.id: (trial, drive(agent, trial)) for trial in load_suite(suite).episodes}


def faulty(results: Results) -> list[tuple[Trial, Outcome]]:
    return [(trial, outcome) for trial, outcome in results.values() if not trial.is_twin]


def completed(results: Results) -> int:
    """Return how many twins took the commanded exit."""
    return sum(one.verdict is Verdict.EXIT_COMMANDED for trial, one in results.values() if trial.is_twin)


def verdicts(results: list[tuple[Trial, Outcome]]) -> Counter[str]:
    return Counter(outcome.verdict.value for _, outcome in results)
