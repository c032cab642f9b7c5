"""What a suite can show."""

import itertools
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from wrongturn_agents.suites import installed_suite
from wrongturn_client.cli import app
from wrongturn_judge import p_of_marks
from wrongturn_protocol.intervals import LEVEL, marks_of
from wrongturn_statistics import power
from wrongturn_statistics.power import RUNS, alike, chance, filled, strata


def test_simulated_chances_are_the_exact_ones() -> None:
    """Of six trials each, all outcomes can be listed."""
    trials = [trial for trial in installed_suite("smoke@3").trials.values() if not trial.is_twin]
    cells = len(strata(trials))
    first, second = 0.05, 0.95
    marks = {bits: marks_of(zip(trials, map(bool, bits), strict=True)) for bits in itertools.product((0, 1), repeat=6)}
    exact = sum(
        float(np.prod([rate if bit else 1 - rate for bits, rate in ((a, first), (b, second)) for bit in bits]))
        for a, b in itertools.product(marks, repeat=2)
        if p_of_marks(marks[a], marks[b]) <= LEVEL
    )
    found = chance(trials, alike(first, cells), alike(second, cells), 1)
    # Five standard errors.
    assert found == pytest.approx(exact, abs=5 * np.sqrt(0.25 / RUNS))
    assert 0.5 < exact < 0.9


@pytest.mark.parametrize("suite", ["wrong-command@3", pytest.param("wrong-command-unseen@1", marks=pytest.mark.soak)])
def test_equal_agents_differ_in_five_percent_at_most_and_draws_help(
    suite: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(power, "RUNS", 150)
    trials = [*installed_suite(suite).trials.values()]
    assert chance(trials, alike(0.3), alike(0.3), 1) < 0.09
    one, four = (chance(trials, alike(0.2), alike(0.4), draws) for draws in (1, 4))
    assert one + 0.2 < four
    assert chance(trials, filled(0.3), filled(0.5), 1) > one


def test_the_command() -> None:
    words = ["power", "--difference", "0.3", "--rate", "0.1", "--json", "-"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    found = json.loads(done.output)
    assert (found["suite"], found["draws"]) == ("wrong-command@3", 1)
    assert [one["fail"] for one in found["agents"]] == ["in all cells alike", "always in some cells"]
    assert all(one["chance"] > 0.8 and one["draws_needed"] == 1 for one in found["agents"])
    assert "found at 5 %" in CliRunner().invoke(app, words[:-2]).output
    for wrong, why in (
        (["--difference", "0.9"], "--difference: 0.3 and 0.9 are more than 1"),
        (["--difference", "0.1", "--suite", "navigation@1"], "--suite: navigation@1 has journeys"),
    ):
        failed = CliRunner().invoke(app, ["power", *wrong])
        assert failed.exit_code == 1
        assert why in str(failed.exception)
