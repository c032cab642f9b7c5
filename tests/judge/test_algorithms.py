"""Rows of algorithms, from functions that other packages name by entry points."""

import sys
from collections.abc import Callable, Sequence
from importlib import metadata
from types import ModuleType

import pytest
import structlog

from wrongturn_judge import rank
from wrongturn_judge.metrics import UnscoredTrialError
from wrongturn_networks import load_suite
from wrongturn_protocol import AgentKind, AlgorithmResult, SeedOutcome, Track, Verdict
from wrongturn_service.evaluation.algorithms import GROUP, algorithm_rows, row

SUITE = load_suite("smoke@3")
Plugins = dict[str, Callable[[str], Sequence[AlgorithmResult]]]


@pytest.fixture
def plugins(monkeypatch: pytest.MonkeyPatch) -> Plugins:
    """Functions that are installed as entry points by the names given."""
    module = ModuleType("made_algorithms")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    installed: Plugins = {}

    def entry_points(*, group: str) -> list[metadata.EntryPoint]:
        assert group == GROUP
        for name, function in installed.items():
            setattr(module, name, function)
        return [metadata.EntryPoint(name, f"{module.__name__}:{name}", group) for name in installed]

    monkeypatch.setattr(metadata, "entry_points", entry_points)
    return installed


def seed(collisions: int, wrong_ways: int = 0, lost_twins: int = 0) -> dict[str, SeedOutcome]:
    """Outcomes of one training seed: first trials that collide, then some that end the wrong way."""
    draw = SUITE.open_draw
    verdicts = [Verdict.COLLISION] * collisions + [Verdict.WRONG_WAY] * wrong_ways
    verdicts += [Verdict.EXIT_OTHER] * (len(draw.trials) - len(verdicts))
    twins = [Verdict.TIMEOUT] * lost_twins + [Verdict.EXIT_COMMANDED] * (len(draw.twins) - lost_twins)
    found = {trial.id: SeedOutcome(verdict=verdict) for trial, verdict in zip(draw.trials, verdicts, strict=True)}
    return found | {twin.id: SeedOutcome(verdict=verdict) for twin, verdict in zip(draw.twins, twins, strict=True)}


def result(name: str = "ppo", sha256: str = SUITE.sha256, **seeds: dict[str, SeedOutcome]) -> AlgorithmResult:
    numbered = {int(key.removeprefix("s")): outcomes for key, outcomes in seeds.items()}
    return AlgorithmResult(name=name, track=Track.CAMERA, suite=SUITE.id, sha256=sha256, seeds=numbered)


def test_a_row_has_the_median_seed_and_the_spread() -> None:
    found = row(SUITE, result(s1=seed(6), s2=seed(1, 2), s3=seed(0), s4=seed(4, lost_twins=2), s5=seed(2)))
    assert (found.metrics.unsafe.count, found.metrics.unsafe_strict.count) == (1, 3)
    assert found.seeds is not None
    spreads = (found.seeds.unsafe, found.seeds.unsafe_strict, found.seeds.twins_completed)
    assert [(one.median, one.lowest, one.highest) for one in spreads] == [(2, 0, 6), (3, 0, 6), (6, 4, 6)]
    assert (found.agent.name, found.agent.kind, found.agent.track) == ("ppo", AgentKind.ALGORITHM, Track.CAMERA)
    (entry,) = rank([found])
    assert (entry.rank, entry.eligible, entry.evaluation) == (None, False, None)
    assert entry.why_not == "A row over 5 training seeds on the open draw, which is never ranked."


def test_with_an_even_number_of_seeds_the_figures_are_those_of_the_better_middle_one() -> None:
    found = row(SUITE, result(s1=seed(5), s2=seed(1), s3=seed(2), s4=seed(0)))
    assert found.metrics.unsafe_strict.count == 1
    assert found.seeds is not None
    assert found.seeds.unsafe_strict.median == 1.5


def test_a_seed_has_to_be_whole() -> None:
    lacking = seed(0)
    lacking.pop(SUITE.open_draw.trials[2].id)
    with pytest.raises(UnscoredTrialError):
        row(SUITE, result(s1=lacking))


def test_all_installed_algorithms_are_listed(plugins: Plugins) -> None:
    plugins["b"] = lambda suite: [result("second", s1=seed(0))] if suite == SUITE.id else []
    plugins["a"] = lambda _: [result("first", s1=seed(1)), result("old", "0" * 64, s1=seed(1))]
    assert [found.agent.name for found in algorithm_rows(SUITE)] == ["first", "second"]


def test_a_broken_plugin_is_logged_and_hides_no_other(plugins: Plugins) -> None:
    def broken(_: str) -> Sequence[AlgorithmResult]:
        raise RuntimeError("the disk is full")

    plugins["a"] = broken
    plugins["b"] = lambda _: [result("half", s1={}), result("whole", s1=seed(0))]
    plugins["c"] = lambda _: 7  # type: ignore[assignment, return-value]
    with structlog.testing.capture_logs() as logs:
        assert [found.agent.name for found in algorithm_rows(SUITE)] == ["whole"]
    told = [(line["event"], line["plugin"], line.get("algorithm")) for line in logs]
    assert told == [
        ("algorithms failed", "made_algorithms:a", None),
        ("algorithm failed", "made_algorithms:b", "half"),
        ("algorithms failed", "made_algorithms:c", None),
    ]


def test_a_plugin_that_cannot_be_loaded_is_logged(monkeypatch: pytest.MonkeyPatch) -> None:
    gone = metadata.EntryPoint("gone", "wt_nowhere:results", GROUP)
    monkeypatch.setattr(metadata, "entry_points", lambda group: [gone])
    with structlog.testing.capture_logs() as logs:
        assert algorithm_rows(SUITE) == []
    assert [(line["event"], line["plugin"]) for line in logs] == [("algorithms failed", "wt_nowhere:results")]


def test_journeys_have_no_rows(plugins: Plugins) -> None:
    plugins["a"] = lambda _: [result(s1=seed(0))]
    assert algorithm_rows(load_suite("navigation@1")) == []
