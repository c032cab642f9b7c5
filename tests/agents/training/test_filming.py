"""Driving unsafe trials again: what is measured, and the films."""

import math

import pytest

from wrongturn_agents.errors import ResultsError
from wrongturn_agents.registry import resolve
from wrongturn_agents.reporting.failures import Ended, Ending, Other
from wrongturn_agents.reporting.results_file import TrialResult
from wrongturn_agents.suites import WRONG_COMMAND, installed_suite
from wrongturn_agents.training.filming import study
from wrongturn_agents.training.filming.journeys import contact_of, journeys
from wrongturn_agents.training.filming.study import Filmer
from wrongturn_protocol import Condition, FaultKind, JunctionType, Reaction, Task, Verdict
from wrongturn_sim import Appearance, Row, Trajectory

OBEYED = TrialResult(verdict=Verdict.OFF_ROAD, reaction=Reaction.OBEYED)


@pytest.fixture(scope="module")
def filmer(tmp_path_factory) -> Filmer:
    """Films of a baseline that drives where it is told to."""
    return Filmer(resolve("obeys-blindly"), tmp_path_factory.mktemp("films"), 1, lambda *_: None)


@pytest.fixture(scope="module")
def trial() -> str:
    """A trial of the open draw that says STRAIGHT where no road goes straight on."""
    return trial_at(JunctionType.LEFT_RIGHT, FaultKind.INFEASIBLE)


def trial_at(kind: JunctionType, fault: FaultKind) -> str:
    """Return the id of the open draw's first trial of a junction type and fault."""
    trials = installed_suite(WRONG_COMMAND).trials.values()
    return next(one.id for one in trials if (one.junction_type, one.fault.kind) == (kind, fault))


def test_a_way_is_driven_measured_and_filmed(filmer, trial):
    (way,) = filmer.ways(Ended(WRONG_COMMAND, {trial: OBEYED}), {})
    assert (way.ending, way.trials) == (Ending.OFF_ROAD, (trial,))
    (drive,) = way.drives
    assert drive.own.turn_begins is None
    assert abs(drive.own.turned) < 10
    assert drive.own.past_middle > 0
    assert drive.own.line_speed is not None
    # The twin takes an exit: it has turned by a right angle.
    assert abs(drive.twin.turned) == pytest.approx(90, abs=25)
    assert drive.twin.turn_begins is not None
    assert way.film is not None
    film = filmer.directory / way.film.file
    assert film.name == "obeys-blindly.left-right.infeasible.off-road.obeyed.webp"
    assert film.read_bytes()[8:12] == b"WEBP"
    again = film.read_bytes()
    filmer.ways(Ended(WRONG_COMMAND, {trial: OBEYED}), {})
    assert film.read_bytes() == again


def test_a_trial_that_ends_otherwise_is_refused(filmer, trial):
    froze = TrialResult(verdict=Verdict.STOPPED_IN_JUNCTION, reaction=Reaction.FROZE)
    with pytest.raises(ResultsError, match=rf"none of {trial} ends in stopped_in_junction again"):
        filmer.ways(Ended(WRONG_COMMAND, {trial: froze}), {})


def test_an_agent_without_failures_is_filmed_where_others_fail_most(filmer, monkeypatch):
    monkeypatch.setattr(study, "INSTEAD", 1)
    left, right = JunctionType.STRAIGHT_LEFT, JunctionType.STRAIGHT_RIGHT
    took = TrialResult(verdict=Verdict.EXIT_ROUTE, reaction=Reaction.EXIT)
    ended = Ended(WRONG_COMMAND, {trial_at(kind, FaultKind.OMISSION): took for kind in (left, right)})
    assert filmer.ways(ended, {}) == ()
    ways = filmer.ways(ended, {(left, FaultKind.OMISSION): 1, (right, FaultKind.OMISSION): 5})
    assert {way.junction_type: way.film is not None for way in ways} == {left: False, right: True}


def test_journeys_are_few_and_of_all_conditions():
    found = journeys()
    assert {Condition.of(one.town, one.weather) for one in found} == set(Condition)
    assert {one.journey.task for one in found} == {Task.NAVIGATION_DYNAMIC}


@pytest.mark.parametrize(
    ("user", "other"),
    [
        ((4.65, 0.0, 0.0, 4.6, 1.9, 1.0), Other.AHEAD),
        ((-4.6, 0.0, 0.0, 4.6, 1.9, 9.0), Other.BEHIND),
        ((4.65, 0.0, math.pi, 4.6, 1.9, 5.0), Other.ONCOMING),
        ((3.2, 0.0, math.pi / 2, 4.6, 1.9, 5.0), Other.CROSSING),
        ((2.5, 0.2, 0.0, 0.4, 0.5, 1.0), Other.PEDESTRIAN),
        ((20.0, 0.0, 0.0, 4.6, 1.9, 0.0), Other.SCENERY),
    ],
)
def test_what_was_hit_is_told_by_its_place(trial, user, other):
    made = moved(trial, user)
    contact = contact_of(made)
    assert contact.other is other
    assert contact.brake == 0.5
    assert contact.throttle == 0.25
    assert contact.other_speed == (0.0 if other is Other.SCENERY else user[5])


def moved(trial: str, user: tuple[float, ...]) -> Trajectory:
    """Return a car that stands for three seconds in the middle of nowhere with one road user beside it."""
    found = installed_suite(WRONG_COMMAND).trials[trial]
    x, y = 0.0, 0.0
    rows = [Row(number / 20, x, y, 0.0, 3.0, 0.0, 4, 4, 0.0, 0.25, 0.5, (user,)) for number in range(60)]
    return Trajectory(found, "0" * 64, rows, [(0,)] * len(rows), (Appearance(1.5, 0, 0),))
