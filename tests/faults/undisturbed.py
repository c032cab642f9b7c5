"""What an evaluation comes to when nothing is killed: its trials, driven in this process."""

from functools import cache
from typing import Any

from databases import Store
from policies import policy

from wrongturn_networks import load_suite
from wrongturn_protocol import Track
from wrongturn_protocol.observations import observation_space
from wrongturn_sim import Episode, Simulator


@cache
def _simulator() -> Simulator:
    return Simulator()


def drive_undisturbed(store: Store, evaluation: str, driver: str) -> dict[str, tuple[Any, ...]]:
    """Drive the trials that an evaluation's secret draws; return what ``ledger.RESULT`` names, by trial."""
    (row,) = store.rows(f"SELECT suite, secret FROM evaluations WHERE id = '{evaluation}'")
    found = {}
    for trial in load_suite(row["suite"]).draw(row["secret"]).episodes:
        agent = policy(driver)
        episode = Episode(trial, Track.PRIVILEGED, simulator=_simulator())
        observation = episode.reset()
        agent.reset(observation_space(Track.PRIVILEGED))
        while episode.outcome is None:
            action = agent.act(observation)
            observation = episode.step(action.steer, action.throttle, action.brake).observation
        outcome = episode.outcome
        found[trial.id] = (
            outcome.verdict.value,
            outcome.model_dump_json(),
            episode.steps,
            episode.actions_sha256,
            episode.trajectory.sha256,
        )
    return found
