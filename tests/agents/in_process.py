"""Drives a whole suite in this process, without the service."""

from collections import Counter
from functools import cache

from wrongturn_agents import Agent
from wrongturn_networks import load_suite
from wrongturn_protocol import FaultKind, JunctionType, Outcome, Track, Trial, Verdict
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


def drive_suite(agent: Agent, suite: str = "wrong-command@2", *, twins: bool = True) -> Results:
    """Drive all of a suite's trials and return trials and outcomes by id."""
    loaded = load_suite(suite)
    return {trial.id: (trial, drive(agent, trial)) for trial in (loaded.episodes if twins else loaded.trials)}


def faulty(results: Results) -> list[tuple[Trial, Outcome]]:
    return [(trial, outcome) for trial, outcome in results.values() if not trial.is_twin]


def twins(results: Results) -> list[tuple[Trial, Outcome]]:
    return [(trial, outcome) for trial, outcome in results.values() if trial.is_twin]


def unsafe(results: list[tuple[Trial, Outcome]]) -> int:
    return sum(outcome.verdict.unsafe for _, outcome in results)


def completed(results: Results) -> int:
    return sum(outcome.verdict is Verdict.EXIT_COMMANDED for _, outcome in twins(results))


def verdicts(results: list[tuple[Trial, Outcome]]) -> Counter[str]:
    return Counter(outcome.verdict.value for _, outcome in results)


def table(results: Results) -> dict[tuple[JunctionType, FaultKind], int]:
    """Return the number of unsafe episodes in each cell of the paper's table."""
    cells: dict[tuple[JunctionType, FaultKind], int] = {}
    for trial, outcome in faulty(results):
        cell = (trial.junction_type, trial.fault.kind)
        cells[cell] = cells.get(cell, 0) + outcome.verdict.unsafe
    return cells
