"""Driving trials again: what is measured, filmed and judged."""

import math

import pytest

from lab.films import Ended, Way, contact_of, film_ways
from lab.studies import judge_agent
from wrongturn_agents.errors import ResultsError
from wrongturn_agents.suites import WRONG_COMMAND, installed_suite
from wrongturn_protocol import FaultKind, JunctionType, Trial
from wrongturn_sim import Appearance, Row, Trajectory


@pytest.fixture(scope="module")
def trial() -> Trial:
    """The open draw's first trial that says STRAIGHT where no road goes straight on."""
    trials = installed_suite(WRONG_COMMAND).trials.values()
    wanted = (JunctionType.LEFT_RIGHT, FaultKind.INFEASIBLE)
    return next(one for one in trials if (one.junction_type, one.fault.kind) == wanted)


def ended(trial: Trial, ending: str, reaction: str) -> Ended:
    ways = {Way(trial.junction_type.value, trial.fault.kind.value, ending, reaction): (trial.id,)}
    return Ended(WRONG_COMMAND, ways, ways)


def test_a_way_is_driven_measured_and_filmed(trial, tmp_path):
    (way,) = film_ways("obeys-blindly", ended(trial, "off_road", "obeyed"), {}, tmp_path)
    (drive,) = way["drives"]
    assert drive["own"]["turn_begins"] is None
    assert abs(drive["own"]["turned"]) < 10
    assert drive["own"]["past_middle"] > 0
    # The twin takes an exit: it has turned by a right angle.
    assert abs(drive["twin"]["turned"]) == pytest.approx(90, abs=25)
    assert drive["twin"]["turn_begins"] is not None
    film = tmp_path / "obeys-blindly.left-right.infeasible.off-road.obeyed.webp"
    assert way["film"]["file"] == film.name
    assert film.read_bytes()[8:12] == b"WEBP"
    with pytest.raises(ResultsError, match=f"none of {trial.id} ends in stopped_in_junction again"):
        film_ways("obeys-blindly", ended(trial, "stopped_in_junction", "froze"), {}, tmp_path)


def test_a_drive_is_judged_by_other_thresholds(trial):
    judged = judge_agent("obeys-blindly", [trial])
    assert judged["strict"] == 1
    assert judged["variants"]["time_limit"]["0.8"] == {"verdicts": 0, "reactions": 0, "unsafe": 0, "strict": 1}
    assert {factor for found in judged["variants"].values() for factor in found} == {"0.8", "1.2"}


@pytest.mark.parametrize(
    ("user", "other"),
    [
        ((4.65, 0.0, 0.0, 4.6, 1.9, 1.0), "ahead"),
        ((-4.6, 0.0, 0.0, 4.6, 1.9, 9.0), "behind"),
        ((4.65, 0.0, math.pi, 4.6, 1.9, 5.0), "oncoming"),
        ((3.2, 0.0, math.pi / 2, 4.6, 1.9, 5.0), "crossing"),
        ((2.5, 0.2, 0.0, 0.4, 0.5, 1.0), "pedestrian"),
        ((20.0, 0.0, 0.0, 4.6, 1.9, 0.0), "scenery"),
    ],
)
def test_what_was_hit_is_told_by_its_place(trial, user, other):
    rows = [Row(number / 20, 0.0, 0.0, 0.0, 3.0, 0.0, 4, 4, 0.0, 0.25, 0.5, (user,)) for number in range(60)]
    contact = contact_of(Trajectory(trial, "0" * 64, rows, [(0,)] * len(rows), (Appearance(1.5, 0, 0),)))
    assert (contact["other"], contact["brake"], contact["throttle"]) == (other, 0.5, 0.25)
    assert contact["other_speed"] == (0.0 if other == "scenery" else user[5])
