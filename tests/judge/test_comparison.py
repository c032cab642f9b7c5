"""Two agents on one suite, each on trials of its own."""

import math
from collections.abc import Container, Sequence
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wrongturn_judge import compute
from wrongturn_judge.comparison import Side, compare, p_value
from wrongturn_networks import load_suite
from wrongturn_networks.draws import Draw
from wrongturn_protocol import (
    AgentDetail,
    AgentKind,
    FaultKind,
    JunctionType,
    Metrics,
    Outcome,
    Track,
    Verdict,
    twin_id,
)

SUITE = load_suite("wrong-command@3")


def of(draw: Draw, unsafe: Container[int], verdict: Verdict = Verdict.COLLISION) -> Metrics:
    """Metrics where the trials at the places in ``unsafe`` end so, and all others well."""
    ends = [verdict if place in unsafe else Verdict.EXIT_OTHER for place in range(len(draw.trials))]
    outcomes = zip((trial.id for trial in draw.trials), ends, strict=True)
    twins = ((twin_id(trial), Verdict.EXIT_COMMANDED) for trial in draw.trials)
    return compute(
        draw, {name: Outcome(verdict=end, time=1.0, max_deceleration=0.0) for name, end in (*outcomes, *twins)}
    )


def side(
    name: str, secret: str, unsafe: Container[int] = (), verdict: Verdict = Verdict.COLLISION, **more: Any
) -> Side:
    agent = AgentDetail(id=f"id {name}", name=name, track=more.pop("track", Track.CAMERA), kind=AgentKind.SUBMITTED)
    return Side(agent, of(SUITE.draw(secret), unsafe, verdict), **more)


def test_strata_hold_each_agents_own_trials() -> None:
    found = compare(SUITE.id, side("a", "one", range(10, 15)), side("b", "two", range(20)))
    assert len(found.strata) == 6
    assert {(one.a.trials, one.b.trials) for one in found.strata} == {(10, 10)}
    counts = {(one.junction_type, one.fault): (one.a.unsafe, one.b.unsafe) for one in found.strata}
    assert sorted(counts.values()) == [(0, 0), (0, 0), (0, 0), (0, 0), (0, 10), (5, 10)]
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
    found = compare(SUITE.id, side("a", "one", range(7)), side("b", "two", range(7)))
    assert (found.difference, found.p) == (0, pytest.approx(1))
    assert "not significant" in found.sentence


def test_the_strict_column_is_compared() -> None:
    assert compare(SUITE.id, side("a", "one", range(60), Verdict.WRONG_WAY), side("b", "two")).difference == 1.0
    assert compare(SUITE.id, side("a", "one", range(60), Verdict.TIMEOUT), side("b", "two")).difference == 0.0


def marked(**cells: dict[str, tuple[int, int]]) -> Metrics:
    return of(SUITE.draw("one"), ()).model_copy(update={"marks": cells})


def test_approaches_that_both_drew_are_compared_with_each_other() -> None:
    """An agent fails at some approaches and not at others."""
    hard = {f"Town01.J{n}-N": (1, 1) for n in range(6)}
    easy = {f"Town01.J{n}-S": (0, 1) for n in range(4)}
    assert p_value(marked(cell={**hard, **easy}), marked(cell={**hard, **easy})) == 1.0
    safe = dict.fromkeys(hard, (0, 1))
    assert p_value(marked(cell={**hard, **easy}), marked(cell={**safe, **easy})) == pytest.approx(2 / 2**6)
    # Elsewhere the other trials of the cell are dealt: of four trials, two unsafe, both to the first.
    mine, theirs = {"Town01.J8-N": (1, 1), "Town01.J9-N": (1, 1)}, {"Town01.J8-S": (0, 1), "Town01.J9-S": (0, 1)}
    assert p_value(marked(cell={**easy, **mine}), marked(cell={**easy, **theirs})) == pytest.approx(2 / 6)


def test_drawn_towns_are_dealt_as_a_whole() -> None:
    """Trials in one town are not independent: twenty towns say less than a hundred and twenty trials."""

    def of_towns(first: int, unsafe: Sequence[int]) -> Metrics:
        towns = [f"drawn-{first + number:016x}" for number in range(len(unsafe))]
        cells = range(6)
        return marked(
            **{
                f"drawn.{cell}": {
                    f"{town}.J1-N": (int(cell < count), 1) for town, count in zip(towns, unsafe, strict=True)
                }
                for cell in cells
            }
        )

    assert p_value(of_towns(0, [6] * 10), of_towns(10, [0] * 10)) == pytest.approx(2 / math.comb(20, 10))
    # Two towns of ten were wholly unsafe. As independent trials, 12 of 60 against none would be significant.
    assert p_value(of_towns(0, [6, 6, *[0] * 8]), of_towns(10, [0] * 10)) > 0.4


def test_the_sentence_says_what_else_matters() -> None:
    parked = side("parked", "one", why_not="Completed 0 of 60 twins, at least 54 are needed.")
    found = compare(SUITE.id, parked, side("seer", "two", range(30), track=Track.PRIVILEGED))
    assert "They drive in different tracks (camera and privileged), which are never ranked together." in found.sentence
    assert found.sentence.endswith("parked has no rank: Completed 0 of 60 twins, at least 54 are needed.")


@given(st.sets(st.integers(0, 59)), st.sets(st.integers(0, 59)))
@settings(max_examples=20)
def test_a_and_b_may_change_places(mine, theirs) -> None:
    there, back = (compare(SUITE.id, *pair) for pair in _both_ways(side("a", "x", mine), side("b", "y", theirs)))
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
        return Side(agent, compute(suite.open_draw, ends))

    found = compare(suite.id, driven("a", 25), driven("b", 0))
    assert found.p == pytest.approx(2 / 2**25)  # the same journeys in pairs
    assert len(found.strata) == 16
    assert {(one.junction_type, one.fault) for one in found.strata} == {(None, None)}
    assert len({(one.task, one.condition) for one in found.strata}) == 16
    assert (found.total_a.unsafe, found.total_a.trials, found.total_b.unsafe) == (25, 400, 0)
    assert found.sentence.startswith("a missed its goal in 25 of 400 trials, b in 0 of 400;")
    assert "junction_type" not in found.model_dump_json()
