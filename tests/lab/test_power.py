"""What 60 trials can show, and the page that says so."""

from pathlib import Path

import numpy as np
import pytest

from lab import power
from lab.power import (
    IN_CELL,
    POWER,
    TABLES,
    TRIALS,
    TRUTHS,
    alike,
    chance_behind,
    chance_below,
    coverage,
    filled,
    in_towns,
    of_design,
    power_at,
)
from wrongturn_protocol.intervals import LEVEL, RANK_LEVEL

PAGE = Path(__file__).parents[2] / "docs" / "ranking.md"


@pytest.mark.parametrize("whole", [False, pytest.param(True, marks=pytest.mark.soak)])
@pytest.mark.parametrize("name", TABLES)
def test_the_page_has_the_codes_table(name: str, whole: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    _, _, after = PAGE.read_text("utf-8").partition(f"<!-- python -m lab.power {name} -->\n\n")
    shown = after.partition("\n<!-- end of power -->")[0].splitlines()
    if not whole:  # a row or two
        for rows in ("RATES", "SPREADS"):
            monkeypatch.setattr(power, rows, getattr(power, rows)[1:2])
        monkeypatch.setattr(power, "IN_TOWNS", power.IN_TOWNS[2:])
        monkeypatch.setattr(power, "TRUTHS", dict(list(TRUTHS.items())[8:]))
    rows = TABLES[name]().markdown().splitlines()
    assert (shown == rows) if whole else set(rows) <= set(shown), f"python -m lab.power {name} gives others"


@pytest.mark.parametrize(("first", "second"), [(alike(0.1), alike(0.3)), (filled(0.3), filled(0.4))])
def test_exact_chances_are_what_draws_give(first, second) -> None:
    generator = np.random.default_rng(1)
    draws = [generator.binomial(IN_CELL, cells, size=(2_000, 6)) for cells in (first, second)]
    below, above = (np.array([of_design(one, RANK_LEVEL) for one in each.tolist()]) for each in draws)
    seen = np.mean(below[:, 1] < above[:, 0])
    # Five standard errors of a share of 2,000.
    assert chance_below(first, second) == pytest.approx(seen, abs=5 * np.sqrt(0.25 / 2_000))
    inside = np.mean((below[:, 0] <= np.mean(first)) & (np.mean(first) <= below[:, 1]))
    assert coverage(of_design, first, RANK_LEVEL)[0] == pytest.approx(inside, abs=5 * np.sqrt(0.25 / 2_000))


@pytest.mark.parametrize(("agent", "rate"), [(alike, 0.05), (alike, 0.5), (filled, 0.2)])
def test_the_difference_that_shows_is_the_least(agent, rate: float) -> None:
    found = power_at(rate, agent)
    assert found.shown is not None
    there, nearer = (agent(rate + shown / TRIALS) for shown in (found.shown, found.shown - 1))
    assert chance_below(agent(rate), there) >= POWER > chance_below(agent(rate), nearer)


def test_equal_agents_differ_at_about_five_percent_at_most() -> None:
    alarms = [power_at(rate).false_alarm for rate in np.linspace(0, 1, 6)]
    assert max(alarms) < 0.056
    assert min(alarms[1:-1]) > 0.045
    assert alarms[0] == alarms[-1] == 0
    assert chance_behind(alike(0.2), 2) == pytest.approx(power_at(0.2).false_alarm / 2)
    assert power_at(0.97).shown is None


def test_the_interval_covers_as_it_says() -> None:
    """In fixed towns nearly so: counts are whole, so no interval covers exactly."""
    assert min(coverage(of_design, cells, LEVEL)[0] for cells in TRUTHS.values()) > 0.925
    assert min(coverage(of_design, cells, RANK_LEVEL)[0] for cells in TRUTHS.values()) > 0.79
    rate, (mine, plain) = in_towns(alike(0.3), 1.0, LEVEL)
    assert 0.33 < rate < 0.332
    assert mine[0] > 0.94
    assert plain[0] < 0.89
