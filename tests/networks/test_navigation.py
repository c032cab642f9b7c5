"""``navigation@1``: CoRL 2017's tasks and conditions in its proportions, each route one that can be driven."""

from collections import Counter
from itertools import product
from statistics import mean

import pytest

from wrongturn_networks import Suite, load_suite
from wrongturn_protocol import CORL_TASKS, FaultKind, Journey, Task, Track, Traffic, Trial, Weather

TRAINING = {Weather.CLEAR_NOON, Weather.WET_NOON, Weather.HARD_RAIN_NOON, Weather.CLEAR_SUNSET}
NEW = {Weather.WET_CLOUDY_NOON, Weather.SOFT_RAIN_SUNSET}
CELLS = list(product(("Town01", "Town02"), ("training", "new"), CORL_TASKS))
CORL_LENGTHS = {
    "Town01": {Task.STRAIGHT: 200, Task.ONE_TURN: 400, Task.NAVIGATION: 770, Task.NAVIGATION_DYNAMIC: 770},
    "Town02": {Task.STRAIGHT: 100, Task.ONE_TURN: 170, Task.NAVIGATION: 360, Task.NAVIGATION_DYNAMIC: 360},
}
"""Metres (CoRL 2017, section 4)."""


@pytest.fixture(scope="module")
def suite() -> Suite:
    """The suite."""
    return load_suite("navigation@1")


def _journey(trial: Trial) -> Journey:
    assert trial.journey is not None
    return trial.journey


def _cell(suite: Suite, town: str, weathers: str, task: Task) -> list[Trial]:
    these = TRAINING if weathers == "training" else NEW
    return [t for t in suite.trials if t.town == town and t.weather in these and _journey(t).task is task]


def test_four_hundred_without_twins(suite: Suite) -> None:
    assert len(suite.trials) == 400
    assert suite.episodes == suite.trials
    assert len({trial.id for trial in suite.trials}) == 400
    summary = suite.summary()
    assert (summary.trials, summary.twins) == (400, 0)
    assert suite.tracks == (Track.CAMERA, Track.SEGMENTATION, Track.PRIVILEGED)
    assert not any(trial.is_twin for trial in suite.trials)
    assert {trial.fault.kind for trial in suite.trials} == {FaultKind.NONE}
    assert suite.trial(suite.trials[7].id) is suite.trials[7]


def test_what_the_service_shows_of_a_journey(suite: Suite) -> None:
    for shown, trial in zip(suite.trial_list().trials, suite.trials, strict=True):
        assert (shown.id, shown.twin, shown.journey) == (trial.id, None, trial.journey)
    assert "journey" in shown.model_dump()
    assert "journey" not in load_suite("smoke@3").trial_list().trials[0].model_dump()


@pytest.mark.parametrize(("town", "weathers", "task"), CELLS)
def test_a_cell(suite: Suite, town: str, weathers: str, task: Task) -> None:
    cell = _cell(suite, town, weathers, task)
    assert len(cell) == 25
    times = Counter(trial.weather for trial in cell)
    assert set(times) == (TRAINING if weathers == "training" else NEW)
    assert max(times.values()) - min(times.values()) <= 1
    cars = {"Town01": 20, "Town02": 15}[town] if task is Task.NAVIGATION_DYNAMIC else 0
    assert {trial.traffic for trial in cell} == {Traffic(vehicles=cars, pedestrians=50 if cars else 0)}
    assert mean(_journey(trial).length for trial in cell) == pytest.approx(CORL_LENGTHS[town][task], rel=0.12)
    # Few routes are alike, and no corner of the town is left out.
    pairs = Counter((trial.approach, _journey(trial).goal) for trial in cell)
    assert max(pairs.values()) <= 2
    assert len({trial.approach for trial in cell}) >= 10


def test_conditions_have_routes_of_their_own(suite: Suite) -> None:
    starts = Counter((trial.town, trial.approach, trial.start.distance) for trial in suite.trials)
    assert len(starts) == 300  # navigation's stand twice
