"""Fills PostgreSQL with agents whose evaluations are finished, for ``benchmarks/pages.py`` and its test.

Two baselines drive the suite's open draw in this process. Each agent's episodes are theirs, mixed. So every row is one
that the service could have written.
"""

import asyncio
import hashlib
import random
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import asyncpg
from sqlalchemy.engine import make_url

from wrongturn_agents.registry import resolve
from wrongturn_judge.metrics import compute
from wrongturn_networks import load_suite
from wrongturn_protocol import AgentKind, Outcome, Track, Trial
from wrongturn_protocol.observations import observation_space
from wrongturn_service.storage.database import Database
from wrongturn_sim import Episode, Simulator

DRIVERS: Final = ("careful", "obeys-blindly")
VARIANTS: Final = 40
"""Different mixes. Agents share them, because metrics take longer than rows."""
OWNED: Final = 4
"""Agents of each owner."""
_BEGUN: Final = 1_760_000_000.0
_KINDS: Final = (*(AgentKind.SUBMITTED,) * 8, AgentKind.BASELINE, AgentKind.EXPLOIT)
_TRACKS: Final = (Track.CAMERA, Track.SEGMENTATION, Track.PRIVILEGED)
_ROWS: Final = 2000
"""Episodes that are written at a time."""


@dataclass(frozen=True)
class Drive:
    """One episode of a baseline."""

    trial: Trial
    outcome: Outcome
    steps: int
    trajectory: bytes
    """Canonical JSON."""


@dataclass(frozen=True)
class Filled:
    """What was written."""

    suite: str
    agents: list[str]
    """Ids."""
    evaluations: list[str]
    """Ids, one for each agent."""
    episodes: int
    """Number of episodes."""


def drive(suite: str) -> list[dict[str, Drive]]:
    """Return each baseline's episodes of the suite's open draw, by trial."""
    simulator = Simulator()
    return [{trial.id: _drive(name, trial, simulator) for trial in load_suite(suite).episodes} for name in DRIVERS]


def _drive(name: str, trial: Trial, simulator: Simulator) -> Drive:
    agent = resolve(name).make()
    episode = Episode(trial, Track.PRIVILEGED, simulator=simulator)
    observation = episode.reset()
    agent.reset(observation_space(Track.PRIVILEGED))
    while episode.outcome is None:
        action = agent.act(observation)
        observation = episode.step(action.steer, action.throttle, action.brake).observation
    return Drive(trial, episode.outcome, episode.steps, episode.trajectory.to_json())


async def fill(url: str, suite_id: str, agents: int) -> Filled:
    """Write agents and their evaluations into an empty database, and return their ids.

    Args:
        url: SQLAlchemy URL of an empty database of PostgreSQL.
        suite_id: Suite with an open draw.
        agents: Number of agents.
    """
    await (await Database.open(url)).close()  # makes the tables
    suite = load_suite(suite_id)
    drives = await asyncio.to_thread(drive, suite_id)
    mixes = [_mix(drives, variant / (VARIANTS - 1)) for variant in range(min(VARIANTS, agents))]
    metrics = [compute(suite, {name: found.outcome for name, found in mix.items()}).model_dump_json() for mix in mixes]
    connection = await asyncpg.connect(make_url(url).set(drivername="postgresql").render_as_string(hide_password=False))
    try:
        numbers = range(agents)
        await _copy(connection, "owners", [_owner(number) for number in range(-(-agents // OWNED))])
        await _copy(connection, "agents", [_agent(number) for number in numbers])
        await _copy(
            connection,
            "evaluations",
            [
                {
                    "id": _id("ev", number),
                    "agent_id": _id("ag", number),
                    "suite": suite_id,
                    "suite_sha256": suite.sha256,
                    "entry": "remote",
                    "state": "finished",
                    "secret": suite_id,
                    "trials": len(suite.episodes),
                    "seq": number + 1,
                    "created": _BEGUN + number,
                    "driven": _BEGUN + number,
                    "finished": _BEGUN + number + 3600,
                    "metrics": metrics[number % len(metrics)],
                }
                for number in numbers
            ],
        )
        episodes, trajectories = [], []
        count = 0
        packed = _packed(drives)
        for episode, trajectory in _episodes(mixes, agents, packed):
            episodes.append(episode)
            trajectories.append(trajectory)
            count += 1
            if len(episodes) == _ROWS:
                await _copy(connection, "episodes", episodes)
                await _copy(connection, "trajectories", trajectories)
                episodes, trajectories = [], []
        await _copy(connection, "episodes", episodes)
        await _copy(connection, "trajectories", trajectories)
        await connection.execute("ANALYZE")
    finally:
        await connection.close()
    return Filled(suite_id, [_id("ag", n) for n in numbers], [_id("ev", n) for n in numbers], count)


def _mix(drives: Sequence[Mapping[str, Drive]], share: float) -> dict[str, Drive]:
    """Return episodes of which a share is the second baseline's."""
    dice = random.Random(share)
    return {trial: drives[dice.random() < share][trial] for trial in drives[0]}


def _packed(drives: Sequence[Mapping[str, Drive]]) -> dict[str, dict[str, Any]]:
    """Return the columns that all copies of an episode share, by the SHA-256 of its trajectory."""
    return {
        hashlib.sha256(found.trajectory).hexdigest(): {
            "size": len(found.trajectory),
            "data": zlib.compress(found.trajectory, 6),
        }
        for each in drives
        for found in each.values()
    }


def _episodes(
    mixes: Sequence[Mapping[str, Drive]], agents: int, packed: Mapping[str, Mapping[str, Any]]
) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Yield the rows of all agents' episodes and of their trajectories."""
    ready = [
        [
            (
                {
                    "trial_id": trial,
                    "trial": found.trial.model_dump_json(),
                    "verdict": found.outcome.verdict.value,
                    "outcome": found.outcome.model_dump_json(),
                    "steps": found.steps,
                },
                hashlib.sha256(found.trajectory).hexdigest(),
            )
            for trial, found in mix.items()
        ]
        for mix in mixes
    ]
    for number in range(agents):
        for index, (columns, sha256) in enumerate(ready[number % len(ready)]):
            episode = _id("ep", number * 1000 + index)
            yield (
                {
                    "id": episode,
                    "evaluation_id": _id("ev", number),
                    "agent_id": _id("ag", number),
                    "track": _TRACKS[number % len(_TRACKS)].value,
                    "state": "finished",
                    "created": _BEGUN + number + index,
                    "finished": _BEGUN + number + index + 60,
                    "trajectory_sha256": sha256,
                    "actions_sha256": sha256,
                    **columns,
                },
                {"episode_id": episode, "sha256": sha256, **packed[sha256]},
            )


def _owner(number: int) -> dict[str, Any]:
    name = f"Lab {number}"
    return {"id": _id("ow", number), "name": name, "name_key": name.lower(), "created": _BEGUN}


def _agent(number: int) -> dict[str, Any]:
    name = f"Agent {number}"
    return {
        "id": _id("ag", number),
        "name": name,
        "name_key": name.lower(),
        "track": _TRACKS[number % len(_TRACKS)].value,
        "kind": _KINDS[number % len(_KINDS)].value,
        "description": "Made to measure pages.",
        "homepage": "https://example.org/",
        "created": _BEGUN + number,
        "owner_id": _id("ow", number // OWNED),
    }


def _id(prefix: str, number: int) -> str:
    """Return an id that looks as random as the service's."""
    return f"{prefix}_{hashlib.sha256(f'{prefix}{number}'.encode()).hexdigest()[:24]}"


async def _copy(connection: Any, table: str, rows: Sequence[Mapping[str, Any]]) -> None:
    if rows:
        columns = list(rows[0])
        await connection.copy_records_to_table(
            table, records=[tuple(row[name] for name in columns) for row in rows], columns=columns
        )
