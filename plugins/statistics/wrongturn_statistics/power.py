"""What a suite can show: how often the exact test finds a true difference between two agents."""

from collections.abc import Iterable
from typing import Any, Final, NamedTuple

import numpy as np

from wrongturn_judge import p_of_marks
from wrongturn_protocol import Trial
from wrongturn_protocol.intervals import LEVEL, stratum_of, town_of

RUNS: Final = 500
"""Simulated pairs of evaluations."""
WITHIN_TOWNS: Final = 0.1
"""Correlation of the trials in a drawn town. Shipped agents have about 0, and 0.12 at most (``docs/effects.md``)."""
_SEED: Final = 32
Cells = tuple[float, ...]
"""An agent's true unsafe rate in each cell."""


def alike(rate: float, cells: int = 6) -> Cells:
    """Return an agent that has the same rate in each cell."""
    return (rate,) * cells


def filled(rate: float, cells: int = 6) -> Cells:
    """Return an agent that fails always in as many cells as its rate fills, and never in the others but one."""
    return tuple(min(1.0, max(0.0, cells * rate - cell)) for cell in range(cells))


AGENTS: Final = {"in all cells alike": alike, "always in some cells": filled}
"""Two sorts of agents. Real ones are between them."""


class _Slots(NamedTuple):
    """Where an agent's trials are counted."""

    keys: list[tuple[str, str]]
    """Stratum and place."""
    slot: Any
    """Of each trial the number of its key, (n,)."""
    cell: Any
    """Of each trial the number of its stratum, (n,)."""
    town: Any
    """Of each trial the number of its drawn town, 0 for all others, (n,)."""


def chance(trials: Iterable[Trial], first: Cells, second: Cells, draws: int) -> float:
    """Return how often two agents' evaluations differ at 5 %, each of so many draws.

    ``first`` and ``second`` have a rate for each stratum of the trials, as :func:`strata` orders them. Both agents
    drive the same approaches in fixed towns, and drawn towns of their own.
    """
    trials = [trial for trial in trials if not trial.is_twin]
    sides = [(_slots(trials, draws, side), np.array(rates)) for side, rates in enumerate((first, second))]
    random = np.random.default_rng(_SEED)
    found = 0
    for _ in range(RUNS):
        a, b = (_marks(slots, rates, random) for slots, rates in sides)
        found += p_of_marks(a, b) <= LEVEL
    return found / RUNS


def strata(trials: Iterable[Trial]) -> list[str]:
    """Return the strata of the trials, without twins."""
    return sorted({stratum_of(trial) for trial in trials if not trial.is_twin})


def _slots(trials: list[Trial], draws: int, side: int) -> _Slots:
    cells = strata(trials)
    keys: dict[tuple[str, str], int] = {}
    towns: dict[str, int] = {}
    slot, cell, town = [], [], []
    for draw in range(draws):
        for trial in trials:
            name, stratum = trial.town, stratum_of(trial)
            if town_of(name) is not None:
                name = f"{name}-{side}-{draw}"
                town.append(towns.setdefault(name, len(towns) + 1))
            else:
                town.append(0)
            slot.append(keys.setdefault((stratum, f"{name}.{trial.approach}"), len(keys)))
            cell.append(cells.index(stratum))
    return _Slots([*keys], np.array(slot), np.array(cell), np.array(town))


def _marks(slots: _Slots, rates: Any, random: np.random.Generator) -> dict[str, dict[str, tuple[int, int]]]:
    """Return the marks of one simulated evaluation."""
    rate = rates[slots.cell]
    spread = 1 / WITHIN_TOWNS - 1
    inside = (rate > 0) & (rate < 1) & (slots.town > 0)
    if inside.any():
        # In some towns an agent fails more often than in others: by a beta distribution, whose mean is its rate.
        for one in np.unique(rate[inside]):
            own = random.beta(one * spread, (1 - one) * spread, size=int(slots.town.max()) + 1)
            rate = np.where(inside & (rates[slots.cell] == one), own[slots.town], rate)
    unsafe = random.random(len(rate)) < rate
    count = np.bincount(slots.slot, unsafe, len(slots.keys)).astype(int).tolist()
    of = np.bincount(slots.slot, minlength=len(slots.keys)).tolist()
    marks: dict[str, dict[str, tuple[int, int]]] = {}
    for (stratum, place), one, trials in zip(slots.keys, count, of, strict=True):
        marks.setdefault(stratum, {})[place] = (one, trials)
    return marks
