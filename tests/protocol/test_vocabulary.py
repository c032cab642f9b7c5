"""What must hold of the words, whatever is added to them."""

from itertools import combinations

import pytest

from wrongturn_protocol import (
    DIRECTIONS,
    PAPER_TYPES,
    Command,
    Condition,
    FaultKind,
    JunctionType,
    ProblemType,
    Verdict,
    Weather,
)


def test_the_junction_types_are_all_pairs_of_exits_and_all_three() -> None:
    sets = {frozenset(pair) for pair in combinations(DIRECTIONS, 2)} | {frozenset(DIRECTIONS)}
    assert {kind.exits for kind in JunctionType} == sets
    assert JunctionType.CROSS.missing is None
    for kind in JunctionType:
        assert JunctionType.of(kind.exits) is kind
    for kind in PAPER_TYPES:
        assert {kind.missing} == set(DIRECTIONS) - kind.exits
        assert set(kind.value.split("_")) == {command.name for command in kind.exits}


@pytest.mark.parametrize("exits", [set(), *({one} for one in DIRECTIONS), {Command.LEFT, Command.LANE_FOLLOW}])
def test_exits_that_make_no_junction_are_named(exits: set[Command]) -> None:
    names = ", ".join(sorted(command.name for command in exits)) or "none"
    with pytest.raises(ValueError, match=f"just these exits: {names}"):
        JunctionType.of(frozenset(exits))


def test_conditions_are_corl_s() -> None:
    new = {Weather.WET_CLOUDY_NOON, Weather.SOFT_RAIN_SUNSET}
    for weather in Weather:
        assert Condition.of("Town01", weather) is (Condition.NEW_WEATHER if weather in new else Condition.TRAINING)
        newer = Condition.NEW_TOWN_AND_WEATHER if weather in new else Condition.NEW_TOWN
        assert Condition.of("Town02", weather) is newer


@pytest.mark.parametrize("words", [FaultKind, Verdict, ProblemType])
def test_words_are_fit_for_ids_and_urls(words: type[FaultKind]) -> None:
    values = [word.value for word in words]
    assert len(set(values)) == len(values)
    assert all(value.isascii() and value.replace("-", "_").isidentifier() and value.islower() for value in values)
