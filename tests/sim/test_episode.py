import hashlib
import math

import numpy as np
import pytest

from wrongturn_networks import draw_journey, load_town
from wrongturn_protocol import Task, Track
from wrongturn_sim import (
    Episode,
    EpisodeAlreadyFinishedError,
    EpisodeNotStartedError,
    InvalidActionError,
    InvalidTrialError,
    Trajectory,
    judge,
)


def actions(episode):
    return [row[8:11] for row in episode.trajectory.rows[1::2]]


@pytest.fixture(scope="module")
def ten(make_trial, drive):
    """Ten trials driven to their ends, in both towns and with each fault."""
    return [
        drive(make_trial(town=town, fault=fault, seed=seed))
        for town in ("junctions", "Town01")
        for seed, fault in enumerate(("none", "infeasible", "omission", "infeasible", "none"))
    ]


def test_what_was_driven_before_leaves_no_trace(ten):
    for episode in reversed(ten):
        again = Episode(episode.trial, Track.PRIVILEGED)
        again.reset()
        again.step(0.5, 1.0, 0.0)
        again.reset()
        for action in actions(episode):
            step = again.step(*action)
        assert again.trajectory.to_json() == episode.trajectory.to_json()
        assert again.outcome == episode.outcome
        assert step.terminated or step.truncated


def test_the_judge_finds_the_same_in_the_record(ten):
    for episode in ten:
        assert judge(Trajectory.from_json(episode.trajectory.to_json()), episode.geometry) == episode.outcome


def test_a_row_each_sub_step_and_the_start_first(make_trial):
    trial = make_trial()
    episode = Episode(trial, Track.STATE)
    episode.reset()
    for _ in range(10):
        episode.step(0.1, 0.3, 0.0)
    rows = episode.trajectory.rows
    assert [row.t for row in rows] == [k / 20 for k in range(21)]
    assert rows[0].v == trial.start.speed
    assert rows[0].steering == rows[0].steer == rows[0].throttle == rows[0].brake == 0.0
    assert {row.steer for row in rows[1:]} == {float(np.float32(0.1))}
    assert episode.steps == 10


def test_actions_are_taken_as_float32(make_trial):
    episode = Episode(make_trial(), Track.STATE)
    episode.reset()
    other = Episode(make_trial(), Track.STATE)
    taken = [(0.1, 0.3, 0.0), (-0.7, 0.123456789, 0.0), (np.float32(0.2), np.float64(0.0), 1)]
    for action in taken:
        episode.step(*action)
    other.reset()
    for action in taken:
        other.step(*np.float32(action).tolist())
    assert episode.trajectory.to_json() == other.trajectory.to_json()
    assert episode.actions_sha256 == hashlib.sha256(np.array(taken, "<f4").tobytes()).hexdigest()


@pytest.mark.parametrize("field", ["steer", "throttle", "brake"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1.0001, -1.0001, 1e300, "0", None, 1j, [0.0, 0.0]])
def test_a_bad_action_is_refused_by_its_field_and_nothing_moves(field, value, make_trial):
    episode = Episode(make_trial(), Track.STATE)
    episode.reset()
    with pytest.raises(InvalidActionError, match=rf"action\.{field}"):
        episode.step(**{"steer": 0.0, "throttle": 0.0, "brake": 0.0, field: value})
    assert episode.steps == 0
    assert len(episode.trajectory.rows) == 1
    episode.step(0.0, 0.0, 0.0)


def test_a_step_before_the_reset_and_after_the_end(make_trial):
    episode = Episode(make_trial(), Track.STATE)
    for too_early in (lambda: episode.step(0.0, 0.0, 0.0), episode.abort):
        with pytest.raises(EpisodeNotStartedError, match="reset"):
            too_early()
    episode.reset()
    while not episode.step(0.0, 0.0, 1.0).terminated:
        pass
    assert episode.outcome is not None
    assert episode.outcome.verdict == "not_engaged"
    with pytest.raises(EpisodeAlreadyFinishedError, match="not_engaged"):
        episode.step(0.0, 0.0, 0.0)
    episode.reset()
    assert episode.outcome is None
    assert episode.steps == 0


def test_abort(make_trial):
    episode = Episode(make_trial(), Track.STATE)
    episode.reset()
    episode.step(0.0, 0.3, 0.0)
    outcome = episode.abort()
    assert outcome.verdict == "aborted"
    assert outcome.time == 0.1
    assert episode.abort() == outcome
    with pytest.raises(EpisodeAlreadyFinishedError):
        episode.step(0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("copied", "path"),
    [
        (lambda trial: {"seed": -1}, "trial.seed"),
        (lambda trial: {"start": trial.start.model_copy(update={"speed": math.nan})}, "trial.start.speed"),
        (lambda trial: {"traffic": None}, "trial.traffic"),
        (lambda trial: {"weather": "fog"}, "trial.weather"),
    ],
)
def test_a_trial_that_was_copied_into_nonsense_is_named(make_trial, copied, path):
    trial = make_trial()
    with pytest.raises(InvalidTrialError, match=f"^{path}: "):
        Episode(trial.model_copy(update=copied(trial)), Track.STATE)


def test_a_journey_without_an_end_is_named():
    trial = draw_journey(load_town("junctions"), Task.NAVIGATION, 0)
    endless = trial.journey.model_copy(update={"time_limit": math.nan})
    with pytest.raises(InvalidTrialError, match=r"^trial\.journey\.time_limit: "):
        Episode(trial.model_copy(update={"journey": endless}), Track.STATE)
