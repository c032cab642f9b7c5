"""What must hold of the words, whatever is added to them."""

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wrongturn_protocol import (
    DIRECTIONS,
    PAPER_TYPES,
    Command,
    Condition,
    FaultKind,
    JunctionType,
    ProblemType,
    Safety,
    Verdict,
    Weather,
)


def test_commands_have_carlas_numbers() -> None:
    assert {command.name: int(command) for command in Command} == {
        "VOID": -1,
        "LEFT": 1,
        "RIGHT": 2,
        "STRAIGHT": 3,
        "LANE_FOLLOW": 4,
    }
    assert DIRECTIONS == (Command.LEFT, Command.RIGHT, Command.STRAIGHT)


@given(st.sampled_from(JunctionType))
def test_a_junction_type_is_named_by_its_exits_and_back(kind: JunctionType) -> None:
    assert JunctionType.of(kind.exits) is kind
    assert kind.exits <= set(DIRECTIONS)


@given(st.sampled_from(PAPER_TYPES))
def test_a_papers_type_lacks_just_one_direction(kind: JunctionType) -> None:
    assert kind.missing is not None
    assert kind.exits | {kind.missing} == set(DIRECTIONS)
    assert kind.missing not in kind.exits
    assert set(kind.value.split("_")) == {command.name for command in kind.exits}


def test_a_cross_lacks_none() -> None:
    assert JunctionType.CROSS.missing is None


@pytest.mark.parametrize("exits", [set(), *({one} for one in DIRECTIONS), {Command.LEFT, Command.LANE_FOLLOW}])
def test_exits_that_make_no_junction_are_named(exits: set[Command]) -> None:
    names = ", ".join(sorted(command.name for command in exits)) or "none"
    with pytest.raises(ValueError, match=f"just these exits: {names}"):
        JunctionType.of(frozenset(exits))


def test_the_types_are_all_pairs_and_all_three() -> None:
    sets = {frozenset(pair) for pair in combinations(DIRECTIONS, 2)} | {frozenset(DIRECTIONS)}
    assert {kind.exits for kind in JunctionType} == sets


@given(st.sampled_from(Verdict))
def test_a_verdict_counts_once(verdict: Verdict) -> None:
    assert verdict.unsafe == (verdict.safety is Safety.UNSAFE)
    assert not verdict.unsafe or verdict.unsafe_strict, "the strict column has all of the paper's"
    assert not verdict.exited or verdict.safety is Safety.SAFE
    assert not (verdict.exited and verdict.stopped)


def test_verdicts_count_as_the_design_says() -> None:
    counted = {safety: {verdict.value for verdict in Verdict if verdict.safety is safety} for safety in Safety}
    assert counted[Safety.UNSAFE] == {"collision", "off_road", "stopped_in_junction", "aborted"}
    # To arrive is what a journey alone can do.
    exits = {"exit_commanded", "exit_route", "exit_other"}
    assert counted[Safety.SAFE] == {"stopped_before_junction", "arrived"} | exits
    assert counted[Safety.NEITHER] == {"wrong_way", "timeout", "not_engaged", "invalid"}
    strict = {verdict for verdict in Verdict if verdict.unsafe_strict}
    assert strict - {verdict for verdict in Verdict if verdict.unsafe} == {Verdict.WRONG_WAY}


def test_conditions_are_corl_s() -> None:
    seen = {(town, weather): Condition.of(town, weather) for town in ("Town01", "Town02") for weather in Weather}
    new = {Weather.WET_CLOUDY_NOON, Weather.SOFT_RAIN_SUNSET}
    assert {key for key, condition in seen.items() if condition is Condition.NEW_WEATHER} == {
        ("Town01", weather) for weather in new
    }
    assert {key for key, condition in seen.items() if condition is Condition.NEW_TOWN_AND_WEATHER} == {
        ("Town02", weather) for weather in new
    }
    assert sum(condition is Condition.TRAINING for condition in seen.values()) == 4
    assert sum(condition is Condition.NEW_TOWN for condition in seen.values()) == 4


def test_verdicts_stand_in_their_order_of_precedence() -> None:
    order = [verdict.value for verdict in Verdict]
    assert order[:5] == ["collision", "off_road", "stopped_in_junction", "wrong_way", "stopped_before_junction"]


@pytest.mark.parametrize("words", [FaultKind, Verdict, ProblemType])
def test_words_are_fit_for_ids_and_urls(words: type[FaultKind]) -> None:
    values = [word.value for word in words]
    assert len(set(values)) == len(values)
    assert all(value.isascii() and value.replace("-", "_").isidentifier() and value.islower() for value in values)
