"""Effects of factors: the differences, their intervals, and what trials cannot tell."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import t
from typer.testing import CliRunner

from lab import effects as simulated
from wrongturn_agents.errors import ResultsError
from wrongturn_agents.suites import WRONG_COMMAND, installed_suite
from wrongturn_client.cli import app
from wrongturn_statistics.effects import Effect, Observed, cluster_of, effects_of

PAGE = Path(__file__).parents[3] / "docs" / "effects.md"


def observed(rate: float = 0.4, agent: str = "one") -> list[Observed]:
    trials = [trial for trial in installed_suite(WRONG_COMMAND).trials.values() if not trial.is_twin]
    random = np.random.default_rng(4)
    return [Observed(agent, trial, bool(random.random() < rate)) for trial in trials]


def told(seen: list[Observed]) -> Iterator[Effect]:
    return (one for one in effects_of(seen).effects if one.level != one.reference)


def test_a_single_factor_has_the_plain_difference_and_the_bias_reduced_interval() -> None:
    seen = [one for one in observed() if one.trial.junction_type == "LEFT_RIGHT"]
    (found,) = told(seen)
    omission = np.array([one.trial.fault.kind == "omission" for one in seen], float)
    unsafe = np.array([one.unsafe for one in seen], float)
    assert (found.factor, found.level, found.reference) == ("fault", "omission", "infeasible")
    assert (found.unsafe, found.trials) == (unsafe[omission > 0].sum(), 10)
    assert found.difference == pytest.approx(unsafe[omission > 0].mean() - unsafe[omission == 0].mean())
    # Mancl and DeRouen's variance, written out.
    design = np.column_stack([np.ones(len(seen)), omission])
    bread = np.linalg.inv(design.T @ design)
    left = unsafe - design @ bread @ design.T @ unsafe
    places = np.array([cluster_of(one.trial) for one in seen])
    meat = np.zeros((2, 2))
    for place in set(places):
        own = design[places == place]
        score = own.T @ np.linalg.solve(np.eye(len(own)) - own @ bread @ own.T, left[places == place])
        meat += np.outer(score, score)
    half = t.ppf(0.975, len(set(places)) - 1) * np.sqrt((bread @ meat @ bread)[1, 1])
    assert (found.low, found.high) == pytest.approx((found.difference - half, found.difference + half))


def test_order_and_names_of_agents_change_nothing_but_the_sign() -> None:
    first, second = observed(0.2, "b"), observed(0.7, "a")
    forward, backward = effects_of(first + second), effects_of(second + first)
    assert forward.clusters == backward.clusters == 12
    (one,), (other,) = (
        [e for e in each.effects if e.factor == "agent" and e.p is not None] for each in (forward, backward)
    )
    assert (one.reference, one.level) == ("b", "a")
    assert one.difference == pytest.approx(-other.difference)
    assert one.p == pytest.approx(other.p)
    assert one.p < 0.001


def test_what_the_trials_cannot_tell_is_left_open() -> None:
    never = [one._replace(unsafe=False) for one in observed()]
    found = effects_of(never)
    assert found.why_none == "All trials ended alike."
    assert all(one.difference is None and one.unsafe == 0 for one in found.effects)
    few = [one for one in observed() if cluster_of(one.trial) in {"Town01.J1", "Town01.J2"}]
    assert "junctions or drawn towns" in str(effects_of(few).why_none)
    # A level in a single cluster: what the junction adds cannot be told from what the level does.
    place = cluster_of(observed()[0].trial)
    lone = [
        one._replace(trial=one.trial.model_copy(update={"weather": "WetCloudyNoon"}))
        if cluster_of(one.trial) == place
        else one
        for one in observed()
    ]
    assert [one.difference for one in told(lone) if one.factor == "weather"] == [None]
    assert all(one.difference is not None for one in told(lone) if one.factor != "weather")
    with pytest.raises(ResultsError, match="has no trials with a fault"):
        effects_of([])


def test_a_variance_that_is_zero_but_for_rounding_gives_no_interval() -> None:
    # Two unsafe trials that balance each other: of the third column, nothing is left but -1e-18.
    found = told([one._replace(unsafe=number in {13, 43}) for number, one in enumerate(observed())])
    assert [one.difference is None for one in found] == [False, False, True]


def test_the_intervals_cover(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulated, "RUNS", 60)
    for covered, width in simulated.coverage(WRONG_COMMAND, "by fault, type, town, weather", 1.0).values():
        assert covered > 0.88
        assert 0.3 < width < 0.7


@pytest.mark.soak
def test_the_page_has_the_codes_table() -> None:
    _, _, after = PAGE.read_text("utf-8").partition("<!-- python -m lab.effects -->\n\n")
    assert after.partition("\n<!-- end of effects -->")[0] == simulated.table().markdown().rstrip("\n")


def test_the_command() -> None:
    done = CliRunner().invoke(app, ["effects", "ppo-image", "marln", "--json", "-"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.output)
    assert (found["trials"], found["clusters"], found["why_none"]) == (120, 12, None)
    assert {one["factor"] for one in found["effects"]} == {"agent", "fault", "junction_type"}
    shown = CliRunner().invoke(app, ["effects", "ppo-image"]).output
    assert "compared with" in shown
    assert "LEFT_RIGHT" in shown
    assert "All trials ended alike." in CliRunner().invoke(app, ["effects", "careful"]).output
