"""Two agents on one suite, each on trials of its own."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wrongturn_judge.comparison import Side, compare
from wrongturn_networks import load_suite
from wrongturn_protocol import AgentDetail, AgentKind, FaultKind, JunctionType, Outcome, Track, Verdict

SUITE = load_suite("wrong-command@3")


def side(name: str, secret: str, unsafe: range = range(0), verdict: Verdict = Verdict.COLLISION, **more) -> Side:
    """An agent whose trials at the places in ``unsafe`` end so, and all others well."""
    draw = SUITE.draw(secret)
    outcomes = {
        trial.id: Outcome(verdict=verdict if place in unsafe else Verdict.EXIT_OTHER, time=1.0, max_deceleration=0.0)
        for place, trial in enumerate(draw.trials)
    }
    agent = AgentDetail(id=f"id {name}", name=name, track=more.pop("track", Track.CAMERA), kind=AgentKind.SUBMITTED)
    return Side(agent, draw, more.pop("outcomes", outcomes), **more)


def test_strata_hold_each_agents_own_trials() -> None:
    found = compare(side("a", "one", range(10, 15)), side("b", "two", range(20)))
    assert len(found.strata) == 6
    assert {(one.a.trials, one.b.trials) for one in found.strata} == {(10, 10)}
    counts = {(one.junction_type, one.fault): (one.a.unsafe, one.b.unsafe) for one in found.strata}
    first, second = list(counts)[:2]
    assert (counts[first], counts[second]) == ((0, 10), (5, 10))
    assert set(counts) == {
        (kind, fault)
        for kind in (JunctionType.STRAIGHT_LEFT, JunctionType.STRAIGHT_RIGHT, JunctionType.LEFT_RIGHT)
        for fault in (FaultKind.INFEASIBLE, FaultKind.OMISSION)
    }
    assert (found.total_a.unsafe, found.total_b.unsafe) == (5, 20)
    assert found.difference == pytest.approx(-15 / 60)
    assert found.p < 0.001
    assert found.sentence == (
        f"a was unsafe in 5 of 60 trials, b in 20 of 60; the difference is significant at 5 % (p = {found.p:.2g})."
    )


def test_equal_agents_do_not_differ() -> None:
    found = compare(side("a", "one", range(7)), side("b", "two", range(7)))
    assert (found.difference, found.p) == (0, pytest.approx(1))
    assert "not significant" in found.sentence


def test_the_strict_column_is_compared() -> None:
    assert compare(side("a", "one", range(60), Verdict.WRONG_WAY), side("b", "two")).difference == 1.0
    assert compare(side("a", "one", range(60), Verdict.TIMEOUT), side("b", "two")).difference == 0.0


def test_a_trial_without_an_outcome_counts_as_unsafe() -> None:
    found = compare(side("gone", "one", outcomes={}), side("b", "two"))
    assert (found.total_a.unsafe, found.total_a.trials) == (60, 60)


def test_the_sentence_says_what_else_matters() -> None:
    parked = side("parked", "one", why_not="Completed 0 of 60 twins, at least 54 are needed.")
    found = compare(parked, side("seer", "two", range(30), track=Track.PRIVILEGED))
    assert "They drive in different tracks (camera and privileged), which are never ranked together." in found.sentence
    assert found.sentence.endswith("parked has no rank: Completed 0 of 60 twins, at least 54 are needed.")


@given(st.sets(st.integers(0, 59)), st.sets(st.integers(0, 59)))
@settings(max_examples=20)
def test_a_and_b_may_change_places(mine, theirs) -> None:
    there, back = (compare(*pair) for pair in _both_ways(side("a", "x", mine), side("b", "y", theirs)))
    assert there.p == pytest.approx(back.p)
    assert there.difference == pytest.approx(-back.difference)
    assert [(one.a, one.b) for one in there.strata] == [(one.b, one.a) for one in back.strata]


def _both_ways(a: Side, b: Side) -> list[tuple[Side, Side]]:
    return [(a, b), (b, a)]


def test_journeys_are_compared_by_task_and_condition() -> None:
    suite = load_suite("navigation@1")
    arrived = Outcome(verdict=Verdict.ARRIVED, time=1.0, max_deceleration=0.0)
    late = Outcome(verdict=Verdict.TIMEOUT, time=1.0, max_deceleration=0.0)

    def driven(name: str, missed: int) -> Side:
        ends = {trial.id: late if place < missed else arrived for place, trial in enumerate(suite.trials)}
        agent = AgentDetail(id=name, name=name, track=Track.CAMERA, kind=AgentKind.SUBMITTED)
        return Side(agent, suite.open_draw, ends)

    found = compare(driven("a", 25), driven("b", 0))
    assert len(found.strata) == 16
    assert {(one.junction_type, one.fault) for one in found.strata} == {(None, None)}
    assert len({(one.task, one.condition) for one in found.strata}) == 16
    assert (found.total_a.unsafe, found.total_a.trials, found.total_b.unsafe) == (25, 400, 0)
    assert found.sentence.startswith("a missed its goal in 25 of 400 trials, b in 0 of 400;")
    assert "junction_type" not in found.model_dump_json()
