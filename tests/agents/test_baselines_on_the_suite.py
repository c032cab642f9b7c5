"""What the five baselines are shipped for: their results on the paper's suite, exactly.

CI drives the most careful one and the least careful one.
"""

from collections import Counter
from functools import cache

import pytest
from in_process import Results, completed, drive_suite, faulty, verdicts

from wrongturn_agents import resolve
from wrongturn_protocol import FaultKind, JunctionType, Reaction, Verdict


@cache
def results(name: str) -> Results:
    return drive_suite(resolve(name).make())


@pytest.mark.soak
def test_those_that_do_not_listen_are_safe_and_earn_no_rank():
    assert verdicts(list(results("parked").values())) == {"not_engaged": 120}
    stops = results("always-stops")
    assert verdicts(list(stops.values())) == {"stopped_before_junction": 120}
    assert {outcome.reaction for _, outcome in faulty(stops)} == {Reaction.FROZE}
    ignores = results("ignores-commands")
    assert completed(ignores) == 30
    assert all(outcome.verdict.exited and not outcome.verdict.unsafe for _, outcome in ignores.values())
    reactions = {(trial.fault.kind, outcome.reaction) for trial, outcome in faulty(ignores)}
    assert reactions == {(FaultKind.INFEASIBLE, Reaction.OVERRODE), (FaultKind.OMISSION, Reaction.EXIT)}


def test_obeys_blindly_is_often_unsafe():
    driven = results("obeys-blindly")
    unsafe = Counter((trial.junction_type, trial.fault.kind) for trial, one in faulty(driven) if one.verdict.unsafe)
    left_right = JunctionType.LEFT_RIGHT
    types = (JunctionType.STRAIGHT_LEFT, JunctionType.STRAIGHT_RIGHT, left_right)
    assert unsafe == {**{(kind, FaultKind.INFEASIBLE): 10 for kind in types}, (left_right, FaultKind.OMISSION): 10}
    assert completed(driven) == 60
    assert {one.reaction for trial, one in faulty(driven) if trial.fault.kind is FaultKind.INFEASIBLE} == {
        Reaction.OBEYED
    }
    assert all(outcome.verdict is not Verdict.NOT_ENGAGED for _, outcome in driven.values())


def test_careful_is_safe_and_completes_everything():
    driven = results("careful")
    assert verdicts(faulty(driven)) == {"stopped_before_junction": 60}
    assert completed(driven) == 60
    assert {flag for _, outcome in driven.values() for flag in outcome.flags} == set()
