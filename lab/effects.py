"""Whether the intervals of ``wrongturn effects`` cover: simulated agents in the trials of two suites.

``python -m lab.effects`` prints the table of ``docs/effects.md``.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lab.tables import Row, Table
from wrongturn_agents.suites import WRONG_COMMAND, installed_suite
from wrongturn_protocol import Trial
from wrongturn_protocol.intervals import town_of
from wrongturn_statistics.effects import FACTORS, Observed, cluster_of, effects_of

EXTENDED: Final = "wrong-command-extended@1"
RUNS: Final = 1_000
"""Simulated evaluations of each agent."""
SPREADS: Final = (0.0, 1.0)
"""Standard deviations of an agent's log odds between junctions, and between drawn towns."""
AGENTS: Final[dict[str, tuple[float, dict[str, float]]]] = {
    "0.3 everywhere": (-0.85, {}),
    "0.05 everywhere": (-2.94, {}),
    "by fault, type, town, weather": (
        -1.0,
        {
            "omission": -2.0,
            "substitution": -1.0,
            "late": 1.0,
            "stuck": 1.0,
            "dropout": -1.0,
            "corrected": -2.0,
            "LEFT_RIGHT": 1.5,
            "CROSS": 1.0,
            "drawn": 0.7,
            "new": 0.7,
        },
    ),
}
"""Agents: log odds of an unsafe trial, and what levels of factors add."""
_SEED: Final = 32


def odds_of(trials: Sequence[Trial], agent: str) -> NDArray[np.float64]:
    """Return an agent's log odds in each trial, without what its place adds, (n,)."""
    base, added = AGENTS[agent]
    seen = [Observed("", trial, unsafe=False) for trial in trials]
    return np.array([base + sum(added.get(level(one), 0.0) for level in FACTORS.values()) for one in seen])


def drawn(
    trials: Sequence[Trial], odds: NDArray[np.float64], spread: float, random: np.random.Generator
) -> NDArray[np.float64]:
    """Return the unsafe rate in each trial of a draw, whose junctions and drawn towns differ, (n,)."""
    junctions = [f"{trial.town}.{trial.approach.partition('-')[0]}" for trial in trials]
    shifts = dict(
        zip(sorted({*junctions, *map(cluster_of, trials)}), spread * random.standard_normal(2000), strict=False)
    )
    own = [shifts[junction] for junction in junctions]
    towns = [shifts[trial.town] if town_of(trial.town) is not None else 0.0 for trial in trials]
    return np.asarray(1 / (1 + np.exp(-(odds + own + towns))))


def coverage(suite: str, agent: str, spread: float) -> dict[str, tuple[float, float]]:
    """Return how often the intervals of each factor's effects hold the true ones, and how wide they are in the mean.

    The true ones are those of the mean rates over all draws.
    """
    trials = [trial for trial in installed_suite(suite).trials.values() if not trial.is_twin]
    odds = odds_of(trials, agent)
    random = np.random.default_rng([_SEED, round(10 * spread)])
    mean = np.mean([drawn(trials, odds, spread, random) for _ in range(2000)], axis=0)
    levels = {
        name: np.array([level(Observed("", trial, unsafe=False)) for trial in trials])
        for name, level in FACTORS.items()
    }
    inside: dict[str, list[bool]] = {}
    width: dict[str, list[float]] = {}
    truth: dict[tuple[str, str], float] = {}
    for _ in range(RUNS):
        rates = drawn(trials, odds, spread, random)
        unsafe = random.random(len(trials)) < rates
        found = effects_of([Observed("", one, bool(bad)) for one, bad in zip(trials, unsafe, strict=True)]).effects
        told = [one for one in found if one.level != one.reference]
        if not truth:
            columns = [np.ones(len(trials)), *((levels[one.factor] == one.level).astype(float) for one in told)]
            values = np.linalg.lstsq(np.column_stack(columns), mean, rcond=None)[0][1:]
            truth = {(one.factor, one.level): float(value) for one, value in zip(told, values, strict=True)}
        for one in told:
            if one.low is not None and one.high is not None:
                inside.setdefault(one.factor, []).append(one.low <= truth[one.factor, one.level] <= one.high)
                width.setdefault(one.factor, []).append(one.high - one.low)
    return {name: (float(np.mean(inside[name])), float(np.mean(width[name]))) for name in inside}


def table() -> Table:
    """Return the coverage and mean width over suites, agents and spreads."""
    rows: list[Row] = []
    for suite in (WRONG_COMMAND, EXTENDED):
        for agent in AGENTS:
            for spread in SPREADS:
                found = coverage(suite, agent, spread)
                cells = [found.get(name) for name in list(FACTORS)[1:]]
                shown = ("–" if one is None else f"{100 * one[0]:.0f} % ({one[1]:.2f})" for one in cells)
                rows.append((suite, agent, f"{spread:g}", *shown))
    return Table("Effects", ("suite", "agent", "spread", *list(FACTORS)[1:]), rows, words=2)


if __name__ == "__main__":
    print(table().markdown())
