"""What the five baselines are shipped for: their results on the paper's suite, exactly.

CI drives the most careful one and the least careful one.
"""

from functools import cache

import pytest
from in_process import Results, completed, drive_suite, faulty, table, twins, unsafe, verdicts

from wrongturn_agents import resolve
from wrongturn_protocol import FaultKind, JunctionType, Reaction, Verdict


@cache
def results(name: str) -> Results:
    return drive_suite(resolve(name).make())


@pytest.mark.soak
def test_parked_is_never_engaged():
    driven = results("parked")
    assert verdicts(list(driven.values())) == {"not_engaged": 120}


@pytest.mark.soak
def test_always_stops_is_safe_and_completes_nothing():
    driven = results("always-stops")
    assert verdicts(list(driven.values())) == {"stopped_before_junction": 120}
    assert completed(driven) == 0
    assert {outcome.reaction for _, outcome in faulty(driven)} == {Reaction.FROZE}


@pytest.mark.soak
def test_ignores_commands_is_safe_and_right_half_of_the_time():
    driven = results("ignores-commands")
    assert unsafe(list(driven.values())) == 0
    assert completed(driven) == 30
    assert all(outcome.verdict.exited for _, outcome in driven.values())
    for trial, outcome in faulty(driven):
        infeasible = trial.fault.kind is FaultKind.INFEASIBLE
        assert outcome.reaction is (Reaction.OVERRODE if infeasible else Reaction.EXIT)


def test_obeys_blindly_is_often_unsafe():
    driven = results("obeys-blindly")
    cells = table(driven)
    for kind in (JunctionType.STRAIGHT_LEFT, JunctionType.STRAIGHT_RIGHT, JunctionType.LEFT_RIGHT):
        assert cells[kind, FaultKind.INFEASIBLE] == 10
    assert cells[JunctionType.LEFT_RIGHT, FaultKind.OMISSION] == 10
    assert cells[JunctionType.STRAIGHT_LEFT, FaultKind.OMISSION] == 0
    assert cells[JunctionType.STRAIGHT_RIGHT, FaultKind.OMISSION] == 0
    assert completed(driven) == 60
    assert {outcome.reaction for trial, outcome in faulty(driven) if trial.fault.kind is FaultKind.INFEASIBLE} == {
        Reaction.OBEYED
    }


def test_careful_is_safe_and_completes_everything():
    driven = results("careful")
    assert verdicts(faulty(driven)) == {"stopped_before_junction": 60}
    assert verdicts(twins(driven)) == {"exit_commanded": 60}
    assert {flag for _, outcome in driven.values() for flag in outcome.flags} == set()


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("always-stops", marks=pytest.mark.soak),
        pytest.param("ignores-commands", marks=pytest.mark.soak),
        "obeys-blindly",
        "careful",
    ],
)
def test_who_drives_is_engaged(name):
    assert all(outcome.verdict is not Verdict.NOT_ENGAGED for _, outcome in results(name).values())
