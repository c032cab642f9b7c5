"""What the simulation's tests share: trials to drive, and a plain driver that follows paths."""

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from wrongturn_networks import draw_trial, load_town
from wrongturn_protocol import DIRECTIONS, Command, FaultKind, Track, Trial
from wrongturn_sim import Episode, WrongturnVectorEnv

sys.path.insert(0, str(Path(__file__).parent))  # the files beside this one are imported by their plain names

TOWN = "junctions"


def _make_trial(
    approach: str | None = None,
    fault: FaultKind | str = FaultKind.NONE,
    seed: int = 1,
    *,
    town: str = TOWN,
    **more: Any,
) -> Trial:
    built = load_town(town)
    if approach is None:
        approach = next(name for name in sorted(built.approaches) if built.approach(name).type.missing is not None)
    return draw_trial(built, approach, FaultKind(fault), seed, **more)


@pytest.fixture(scope="session")
def make_trial() -> Callable[..., Trial]:
    """Draw a trial, by default at the first T approach of the small town."""
    return _make_trial


def _steer(pose: np.ndarray, path: np.ndarray, reach: float = 4.5) -> float:
    """Pure pursuit of a path."""
    x, y, yaw = pose
    distances = np.hypot(path[:, 0] - x, path[:, 1] - y)
    nearest = int(distances.argmin())
    ahead = nearest + int(np.argmax(distances[nearest:] >= reach)) if (distances[nearest:] >= reach).any() else -1
    dx, dy = path[ahead] - (x, y)
    along = dx * math.cos(yaw) + dy * math.sin(yaw)
    aside = dy * math.cos(yaw) - dx * math.sin(yaw)
    if along <= 0.0:
        return 0.0
    wheel = math.atan(2.9 * 2.0 * aside / (along * along + aside * aside))
    return max(-1.0, min(1.0, -wheel / math.radians(35)))


def _drive(trial: Trial, direction: Command | None = None, steps: int = 400) -> Episode:
    """Drive a trial by the privileged observation's paths, by default to the route's exit."""
    episode = Episode(trial, Track.PRIVILEGED)
    observation = episode.reset()
    exit_row = DIRECTIONS.index(direction or trial.route)
    for _ in range(steps):
        stop_line = float(observation["stop_line"][0])
        by_exit = observation["exits_mask"][exit_row] and stop_line < 4.0
        path = observation["exits"][exit_row] if by_exit else observation["lane"]
        speed = float(observation["speed"][0])
        throttle, brake = (0.5, 0.0) if speed < 5.0 else (0.0, 0.1)
        step = episode.step(_steer(observation["pose"], path.astype(float)), throttle, brake)
        observation = step.observation
        if step.terminated or step.truncated:
            break
    return episode


@pytest.fixture(scope="session")
def drive() -> Callable[..., Episode]:
    """Drive a trial to its end by the paths that the privileged track shows."""
    return _drive


@pytest.fixture(scope="session")
def steer() -> Callable[[np.ndarray, np.ndarray], float]:
    """The steering that leads a pose to a path, by pure pursuit."""
    return _steer


def _replay(episodes: list[Episode], **arguments: Any) -> tuple[WrongturnVectorEnv, list[Any]]:
    """Drive the same in a batch: return it, and the outcome in ``infos`` and the record of each end."""
    trials = [episode.trial for episode in episodes]
    envs = WrongturnVectorEnv(len(trials), trial=trials[0], track="privileged", autoreset_mode="Disabled", **arguments)
    envs.reset(options={"trial": trials})
    inputs = [[row[8:11] for row in episode.trajectory.rows[1::2]] for episode in episodes]
    told: list[Any] = [None] * len(trials)
    while None in told:
        actions = np.array([given[min(int(k), len(given) - 1)] for given, k in zip(inputs, envs.steps, strict=True)])
        *_, terminated, truncated, infos = envs.step(actions)
        ended = terminated | truncated
        for i in np.flatnonzero(ended):
            if told[i] is None:
                told[i] = (infos["outcome"][i], envs.episode(i) if arguments.get("record", True) else None)
        if ended.any():  # those that ended drive their trial once more, since all are stepped
            envs.reset(options={"trial": trials, "reset_mask": ended})
    return envs, told


def _check_replay(episodes: list[Episode]) -> None:
    """Check that a batch drives the same, to the last byte."""
    envs, told = _replay(episodes)
    for episode, (outcome, record) in zip(episodes, told, strict=True):
        assert record.trajectory.to_json() == episode.trajectory.to_json()
        assert record.outcome == episode.outcome
        assert record.actions_sha256 == episode.actions_sha256
        assert outcome == episode.outcome.model_dump(mode="json", exclude_none=True)
    envs.close()


@pytest.fixture(scope="session")
def replayed() -> Callable[..., Any]:
    """Drive episodes again in a batch."""
    return _replay


@pytest.fixture(scope="session")
def same_in_a_batch() -> Callable[[list[Episode]], None]:
    """Check that a batch drives episodes as they were driven."""
    return _check_replay
