"""Rows of algorithms: results over training seeds on the open draw, which other packages provide.

A package names a function ``(suite_id) -> Sequence[AlgorithmResult]`` by an entry point in the group
``wrongturn.algorithms``. One that fails is logged, and the leaderboard stays.
"""

from collections.abc import Callable, Iterable, Sequence
from importlib import metadata
from statistics import median
from typing import Final

import structlog

from wrongturn_judge.metrics import compute
from wrongturn_judge.ranking import RankingInput
from wrongturn_networks import Suite
from wrongturn_protocol import AgentDetail, AgentKind, AlgorithmResult, Metrics, Outcome, Seeds, SeedSpread

GROUP: Final = "wrongturn.algorithms"
"""Entry-point group of the functions that provide results."""
Provider = Callable[[str], Sequence[AlgorithmResult]]
"""Function that returns the results of algorithms on a suite."""


def algorithm_rows(suite: Suite) -> list[RankingInput]:
    """Return a row for each algorithm that an installed package has results of.

    Suites of journeys have none: the results hold verdicts, not distances. Nor do suites that make towns, for an open
    draw would have to build them here.
    """
    if suite.of_journeys or suite.makes_towns:
        return []
    log = structlog.get_logger("algorithms")
    rows: dict[str, RankingInput] = {}
    for point in sorted(metadata.entry_points(group=GROUP), key=lambda point: point.name):
        try:
            provider: Provider = point.load()
            results = [result for result in provider(suite.id) if result.sha256 == suite.sha256]
        except Exception:
            log.exception("algorithms failed", suite=suite.id, plugin=point.value)
            continue
        for result in results:
            try:
                rows.setdefault(result.name, row(suite, result))
            except Exception:
                log.exception("algorithm failed", suite=suite.id, plugin=point.value, algorithm=result.name)
    return list(rows.values())


def row(suite: Suite, result: AlgorithmResult) -> RankingInput:
    """Return the row of one algorithm. Its metrics are those of the median seed in the strict column.

    With an even number of seeds, that is the better of the two in the middle.

    Raises:
        UnscoredTrialError: A seed lacks a trial or a twin of the open draw.
    """
    seeds = {seed: compute(suite.open_draw, _outcomes(result, seed)) for seed in result.seeds}
    order = sorted(seeds, key=lambda seed: (seeds[seed].unsafe_strict.count, seeds[seed].unsafe.count, seed))
    return RankingInput(
        agent=AgentDetail(
            id=f"algorithm {result.name}", name=result.name, track=result.track, kind=AgentKind.ALGORITHM
        ),
        evaluation=None,
        entry=None,
        metrics=_without_times(seeds[order[(len(order) - 1) // 2]]),
        seeds=Seeds(
            count=len(seeds),
            unsafe=_spread(one.unsafe.count for one in seeds.values()),
            unsafe_strict=_spread(one.unsafe_strict.count for one in seeds.values()),
            twins_completed=_spread(one.twins.completed for one in seeds.values()),
        ),
    )


def _outcomes(result: AlgorithmResult, seed: int) -> dict[str, Outcome]:
    """Return a seed's outcomes. Times and decelerations are not known, so these are 0."""
    unknown = {"time": 0.0, "max_deceleration": 0.0}
    return {trial: Outcome(**dict(outcome), **unknown) for trial, outcome in result.seeds[seed].items()}


def _without_times(metrics: Metrics) -> Metrics:
    """Return metrics without the figures that read times."""
    alarms = metrics.false_alarms and metrics.false_alarms.model_copy(update={"seconds_lost": None})
    return metrics.model_copy(update={"false_alarms": alarms})


def _spread(counts: Iterable[int]) -> SeedSpread:
    values = sorted(counts)
    return SeedSpread(median=median(values), lowest=values[0], highest=values[-1])
