"""Agents, evaluations, episodes and leases through whatever order of calls: see :mod:`life_machine`."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from answers import Answers
from hypothesis import HealthCheck, settings
from hypothesis.stateful import run_state_machine_as_test
from life_machine import Life
from served_app import ServedApp


@pytest.fixture
def answers(tmp_path: Path) -> Iterator[Answers]:
    served = ServedApp(tmp_path)
    try:
        yield Answers(served)
    finally:
        served.close()


def live(answers: Answers, tries: int, rules: int) -> int:
    """Make so many tries of so many rules each; how many calls were answered."""

    class Lived(Life):
        pass

    Lived.answers = answers
    run_state_machine_as_test(
        Lived, settings=settings(max_examples=tries, stateful_step_count=rules, suppress_health_check=list(HealthCheck))
    )
    for said, count in sorted(answers.counts.items()):
        print(f"{count:6} {said}")
    total = sum(answers.counts.values())
    print(f"{total:6} calls")
    return total


def test_a_short_life(answers: Answers) -> None:
    assert live(answers, 6, 40) > 150


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_a_life_of_ten_thousand_calls(answers: Answers) -> None:
    assert live(answers, 104, 50) > 10_000
