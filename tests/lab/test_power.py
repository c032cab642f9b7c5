"""What 60 trials can show, and the page that says so."""

from pathlib import Path

import numpy as np
import pytest

from lab.power import POWER, chance_behind, chance_below, power_at, table
from wrongturn_judge.intervals import RANK_LEVEL, wilson

PAGE = Path(__file__).parents[2] / "docs" / "ranking.md"


def test_the_page_has_the_codes_table() -> None:
    page = PAGE.read_text("utf-8")
    _, _, after = page.partition("<!-- python -m lab.power -->\n\n")
    shown, _, _ = after.partition("\n<!-- end of power -->")
    assert shown == table(), "run python -m lab.power and put its table into docs/ranking.md"


@pytest.mark.parametrize(("first", "second"), [(0.0, 0.1), (0.1, 0.3), (0.3, 0.3)])
def test_the_exact_chance_is_what_draws_give(first: float, second: float) -> None:
    generator = np.random.default_rng(1)
    bounds = np.array([wilson(count, 60, RANK_LEVEL) for count in range(61)])
    draws = generator.binomial(60, (first, second), size=(20_000, 2))
    seen = np.mean(bounds[draws[:, 0], 1] < bounds[draws[:, 1], 0])
    # Five standard errors of a share of 20 000.
    assert chance_below(first, second) == pytest.approx(seen, abs=5 * np.sqrt(0.25 / 20_000))


@pytest.mark.parametrize("rate", [0.0, 0.05, 0.2, 0.5])
def test_the_difference_that_shows_is_the_least(rate: float) -> None:
    found = power_at(rate)
    assert found.shown is not None
    assert found.power == chance_below(rate, rate + found.shown / 60)
    assert found.power >= POWER > chance_below(rate, rate + (found.shown - 1) / 60)


def test_equal_agents_differ_at_about_five_percent() -> None:
    alarms = [power_at(rate).false_alarm for rate in np.linspace(0, 1, 41)]
    assert max(alarms) < 0.056
    assert min(alarms[4:-4]) > 0.045
    assert alarms[0] == alarms[-1] == 0


def test_nothing_shows_where_there_is_no_room() -> None:
    assert power_at(0.97).shown is None


def test_among_two_equal_agents_half_of_the_alarms_are_ones_own() -> None:
    assert chance_behind(0.2, 2) == pytest.approx(power_at(0.2).false_alarm / 2)
    assert chance_behind(0.2, 1) == 0
    assert chance_behind(0.2, 2) < chance_behind(0.2, 10) < 9 * chance_behind(0.2, 2)
