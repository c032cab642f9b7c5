"""What 60 trials can show: the coverage of the interval, and the power of two that do not touch.

``python -m lab.power`` prints the tables of ``docs/ranking.md``, or those that it is given by name. Those of fixed
towns are exact: sums of binomial probabilities. Drawn towns are simulated.
"""

import itertools
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lab.tables import Row, Table
from wrongturn_protocol.intervals import LEVEL, RANK_LEVEL, interval, wilson
from wrongturn_statistics.power import Cells, alike, filled

CELLS, IN_CELL = 6, 10
"""Cells of ``wrong-command@3``, and trials in each. In drawn towns: trials in a town, and towns."""
TRIALS: Final = CELLS * IN_CELL
POWER: Final = 0.8
"""Probability with which a difference has to show."""
OWNERS: Final = 10
"""Owners in the last column of the table of power."""
RATES: Final = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5)
"""True unsafe rates of the safer agent in the table of power."""
TRUTHS: Final[dict[str, Cells]] = {
    **{f"{rate:g} in all cells": (rate,) * CELLS for rate in (0.0, 0.02, 0.05, 0.1, 0.3, 0.5)},
    "0.1, 0, 0, 0, 0, 0": (0.1, *[0.0] * 5),
    "0.5, 0, 0, 0, 0, 0": (0.5, *[0.0] * 5),
    "1, 0, 0, 0, 0, 0": (1.0, *[0.0] * 5),
    "1, 0.8, 0.1, 0.05, 0, 0": (1.0, 0.8, 0.1, 0.05, 0.0, 0.0),
    "1, 1, 0.7, 0.1, 0, 0": (1.0, 1.0, 0.7, 0.1, 0.0, 0.0),
    "0.95, 0.95, 0.05 in the others": (0.95, 0.95, *[0.05] * 4),
    "0.7, 0.7, 0.1 in the others": (0.7, 0.7, *[0.1] * 4),
}
"""Agents in the tables of coverage. Honest ones fail nearly always in some cells, and nearly never in others."""
SPREADS: Final = (0.0, 1.0, 2.0)
"""Standard deviations of an agent's log odds between drawn towns."""
IN_TOWNS: Final = ("0.05 in all cells", "0.3 in all cells", "1, 0.8, 0.1, 0.05, 0, 0")
DRAWS: Final = 1_000
"""Simulated draws of each agent in drawn towns."""
_SEED: Final = 30
Method = Callable[[Sequence[int], float], tuple[float, float]]
"""The interval of counts in the cells at a level."""


def of_design(counts: Sequence[int], level: float) -> tuple[float, float]:
    """Return the interval of unsafe trials in each cell."""
    return interval({str(cell): {"": (count, IN_CELL)} for cell, count in enumerate(counts)}, level)


def of_wilson(counts: Sequence[int], level: float) -> tuple[float, float]:
    """Return Wilson's interval, which does not look at cells."""
    return wilson(sum(counts), TRIALS, level)


def of_quadrature(counts: Sequence[int], level: float) -> tuple[float, float]:
    """Return the interval that adds the deviations of Wilson's intervals of the cells in quadrature."""
    rates = np.array(counts) / IN_CELL
    ends = np.array([wilson(count, IN_CELL, level) for count in counts])
    below, above = np.sqrt(((ends - rates[:, None]) ** 2).sum(axis=0)) / CELLS
    return float(rates.mean() - below), float(rates.mean() + above)


METHODS: Final[dict[str, Method]] = {
    "the interval": of_design,
    "Wilson's": of_wilson,
    "cells' in quadrature": of_quadrature,
}


@cache
def _counts() -> NDArray[np.int64]:
    """Return all counts in the cells, ascending within a row, (n, CELLS)."""
    return np.array(list(itertools.combinations_with_replacement(range(IN_CELL + 1), CELLS)))


@cache
def bounds(method: Method, level: float) -> NDArray[np.float64]:
    """Return the lower and upper end of a method's interval for each row of counts, (n, 2)."""
    return np.array([method(one, level) for one in _counts().tolist()])


@cache
def chances(cells: Cells) -> NDArray[np.float64]:
    """Return the probability of each row of counts, whatever their order, (n,)."""
    from scipy.stats import binom

    found: dict[tuple[int, ...], float] = {(): 1.0}
    for rate in cells:
        added: dict[tuple[int, ...], float] = {}
        for count, chance in enumerate(binom.pmf(np.arange(IN_CELL + 1), IN_CELL, rate).tolist()):
            for before, share in found.items() if chance > 0 else ():
                key = tuple(sorted((*before, count)))
                added[key] = added.get(key, 0.0) + share * chance
        found = added
    return np.array([found.get(tuple(one), 0.0) for one in _counts().tolist()])


def coverage(method: Method, cells: Cells, level: float) -> tuple[float, float]:
    """Return how often a method's interval contains an agent's true rate, and its mean width."""
    low, high = bounds(method, level).T
    return _covered(low, high, sum(cells) / CELLS, chances(cells))


def _covered(
    low: NDArray[np.float64], high: NDArray[np.float64], rate: float, weights: NDArray[np.float64]
) -> tuple[float, float]:
    inside = (low <= rate + 1e-12) & (rate - 1e-12 <= high)
    return float(weights @ inside), float(weights @ (high - low))


@dataclass(frozen=True)
class Power:
    """What two agents' counts show about their true rates.

    Attributes:
        shown: Least difference of the true rates, in trials of all, that shows with probability POWER. None if even an
            agent that is always unsafe does not show.
        power: Probability with which that difference shows.
        false_alarm: Probability that two agents of this same rate differ in rank.
    """

    shown: int | None
    power: float | None
    false_alarm: float


def power_at(rate: float, agent: Callable[[float], Cells] = alike, method: Method = of_design) -> Power:
    """Return the power for a safer agent of a true rate, 0 to 1."""
    false_alarm = 2 * chance_below(agent(rate), agent(rate), method)
    for difference in range(1, int(TRIALS * (1 - rate) + 1e-9) + 1):
        power = chance_below(agent(rate), agent(min(1.0, rate + difference / TRIALS)), method)
        if power >= POWER:
            return Power(difference, power, false_alarm)
    return Power(None, None, false_alarm)


def chance_below(first: Cells, second: Cells, method: Method = of_design) -> float:
    """Return the probability that the first agent's interval lies wholly below the second's."""
    return float(_share_below(first, method) @ chances(second))


def chance_behind(cells: Cells, owners: int, method: Method = of_design) -> float:
    """Return the probability that an agent is not first among equal agents of as many owners, one agent each."""
    return float(chances(cells) @ (1 - (1 - _share_below(cells, method)) ** (owners - 1)))


def _share_below(cells: Cells, method: Method) -> NDArray[np.float64]:
    """Return for each row of counts how often an agent's interval lies wholly below that of these counts, (n,)."""
    low, high = bounds(method, RANK_LEVEL).T
    order = np.argsort(high)
    sums = np.concatenate([[0.0], np.cumsum(chances(cells)[order])])
    return np.asarray(sums[np.searchsorted(high[order], low)])


def in_towns(cells: Cells, spread: float, level: float) -> tuple[float, list[tuple[float, float]]]:
    """Return an agent's mean rate over towns, and for each of METHODS but the last its coverage and mean width.

    Each of ten towns has a trial of each cell. The log odds of a town are shifted by a normal number of this spread.
    """
    odds = np.clip(cells, 1e-9, 1 - 1e-9)
    odds = np.log(odds / (1 - odds))
    nodes, weights = np.polynomial.hermite_e.hermegauss(99)
    rate = float(weights @ (1 / (1 + np.exp(-(odds + spread * nodes[:, None])))).mean(axis=1) / weights.sum())
    generator = np.random.default_rng(_SEED)
    shifts = spread * generator.standard_normal((DRAWS, IN_CELL, 1))
    unsafe = generator.random((DRAWS, IN_CELL, CELLS)) < 1 / (1 + np.exp(-(odds + shifts)))
    towns = [f"drawn-{town}." for town in range(IN_CELL)]
    ends = [
        [
            interval({str(cell): dict(zip(towns, ((n, 1) for n in one), strict=True)) for cell, one in by_cell}, level),
            wilson(int(draw.sum()), TRIALS, level),
        ]
        for draw in unsafe
        for by_cell in [list(enumerate(draw.T.astype(int).tolist()))]
    ]
    shares = np.full(DRAWS, 1 / DRAWS)
    return rate, [_covered(low, high, rate, shares) for low, high in np.array(ends).transpose(1, 2, 0)]


def coverage_table() -> Table:
    """Return the coverage of all methods in fixed towns."""
    rows: list[Row] = []
    for name, cells in TRUTHS.items():
        found = [coverage(method, cells, level) for level in (LEVEL, RANK_LEVEL) for method in METHODS.values()]
        rows.append((name, *map(_shown, found)))
    head = [f"{100 * (1 - level):g} %: {name}" for level in (LEVEL, RANK_LEVEL) for name in METHODS]
    return Table("Coverage", ("true unsafe rate in the six cells", *head), rows, words=1)


def towns_table() -> Table:
    """Return the coverage in drawn towns."""
    rows: list[Row] = []
    for name in IN_TOWNS:
        for spread in SPREADS:
            rate, wide = in_towns(TRUTHS[name], spread, LEVEL)
            narrow = in_towns(TRUTHS[name], spread, RANK_LEVEL)[1]
            rows.append((name, f"{spread:g}", f"{100 * rate:.1f} %", *map(_shown, (*wide, *narrow))))
    names = list(METHODS)[:2]
    head = [f"{100 * (1 - level):g} %: {name}" for level in (LEVEL, RANK_LEVEL) for name in names]
    return Table("Coverage in drawn towns", ("in a middling town", "spread", "mean rate", *head), rows, words=1)


def _shown(found: tuple[float, float]) -> str:
    return f"{100 * found[0]:.1f} % ({100 * found[1]:.1f})"


def power_table() -> Table:
    """Return the power over RATES, of agents that are alike in all cells, and of agents that fill cells."""
    rows: list[Row] = []
    for rate in RATES:
        row = [f"{100 * rate:.0f} %"]
        for agent in (alike, filled):
            found, before = power_at(rate, agent), power_at(rate, agent, of_wilson)
            row += [_of(found.shown), _of(before.shown), f"{100 * found.false_alarm:.1f} %"]
        rows.append((*row, f"{100 * chance_behind(alike(rate), OWNERS):.1f} %"))
    each = ("difference that shows, of 60", "by Wilson's", "two equal agents differ")
    head = (
        "true rate of the safer agent",
        *(f"{who}: {what}" for who in ("alike", "filled") for what in each),
        f"alike: not first among {OWNERS} equal ones",
    )
    return Table("Power", head, rows, words=0)


def _of(shown: int | None) -> str:
    return "–" if shown is None else str(shown)


TABLES: Final = {"coverage": coverage_table, "towns": towns_table, "power": power_table}
"""The tables by the name by which ``python -m lab.power`` prints them."""


if __name__ == "__main__":
    for name in sys.argv[1:] or TABLES:
        print(TABLES[name]().markdown())
