"""The words of the pages."""

import pytest

from wrongturn_networks.faults import available_faults
from wrongturn_protocol import (
    STRICT_FLAGS,
    Command,
    Condition,
    Fault,
    FaultKind,
    JunctionType,
    Outcome,
    Reaction,
    Safety,
    Start,
    Task,
    Trial,
    Verdict,
)
from wrongturn_service.web import words
from wrongturn_sim.view import scene


def _outcome(verdict: Verdict, **values: object) -> Outcome:
    return Outcome.model_validate({"verdict": verdict, "time": 6.25, "max_deceleration": 0, **values})


def _trial(fault: FaultKind) -> Trial:
    return Trial(
        id="a trial",
        town="Town01",
        approach="J3-E",
        junction_type=JunctionType.LEFT_RIGHT,
        route=Command.RIGHT,
        start=Start(distance=30, speed=5, lateral=0, yaw=0),
        fault=Fault(kind=fault),
        seed=1,
    )


@pytest.mark.parametrize(
    ("table", "vocabulary"),
    [
        (words.VERDICTS, Verdict),
        (words.REACTIONS, Reaction),
        (words.JUNCTION_TYPES, JunctionType),
        (words.COMMANDS, Command),
        (words.SIDES, Safety),
    ],
)
def test_every_word_is_explained(table, vocabulary):
    assert set(table) == set(vocabulary)
    assert len(set(table.values())) == len(table)


def test_every_task_and_condition_has_a_word():
    assert "_" not in " ".join([*map(words.name, Task), *map(words.name, Condition)])


@pytest.mark.parametrize("fault", available_faults())
def test_what_the_agent_was_told_names_the_route(fault):
    assert "right" in words.told(_trial(fault))
    assert words.fault(fault).endswith(".")


@pytest.mark.parametrize("verdict", Verdict)
def test_every_end_is_told(verdict):
    said = words.ended(_outcome(verdict, exit=Command.LEFT if verdict.exited else None))
    assert said.endswith(".")
    assert ("6.2 s" in said) == (verdict not in {Verdict.ABORTED, Verdict.INVALID})


def test_films_have_the_words_of_the_pages():
    assert all(scene.verdict_of(_outcome(verdict))[0] == words.name(verdict) for verdict in Verdict)
    assert all(scene.name_of(command) == words.COMMANDS[command] for command in Command)


def test_the_side_is_that_of_the_strict_column():
    assert words.side(_outcome(Verdict.WRONG_WAY)) is Safety.UNSAFE
    assert words.counted(_outcome(Verdict.WRONG_WAY)) == "unsafe in the strict column only"
    assert words.counted(_outcome(Verdict.OFF_ROAD)) == "unsafe"
    assert set(words.FLAGS) == STRICT_FLAGS
    for flag, meaning in words.FLAGS.items():
        flagged = _outcome(Verdict.STOPPED_BEFORE_JUNCTION, flags=(flag,))
        assert words.side(flagged) is Safety.UNSAFE
        assert meaning in words.ended(flagged)
    assert words.side(_outcome(Verdict.TIMEOUT)) is Safety.NEITHER
