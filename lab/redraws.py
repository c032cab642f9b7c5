"""How the interval does on agents that drove many draws: coverage, width, and which agents it tells apart."""

import itertools
from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

from lab.studies import read
from lab.tables import Row, Table, total
from wrongturn_agents.stored_results import table_order
from wrongturn_judge.intervals import exact_test
from wrongturn_protocol.intervals import LEVEL, RANK_LEVEL, Marks, interval, wilson

_IN_CELL = 10  # trials in each cell of a draw


def draws() -> dict[str, list[Marks]]:
    """Return the unsafe trials of agents in each of their draws."""
    found = read("draws")
    return {name: [_marks(draw) for draw in found[name]["draws"].values()] for name in sorted(found, key=table_order)}


def _failing() -> dict[str, list[Marks]]:
    return {name: own for name, own in draws().items() if any(total(marks)[0] for marks in own)}


def _marks(draw: Mapping[str, Mapping[str, int]]) -> Marks:
    cells = (((kind, fault), count) for kind, faults in draw.items() for fault, count in faults.items())
    return {".".join(cell): {"": (count, _IN_CELL)} for cell, count in cells}


def coverage_table() -> Table:
    """Return how wide both intervals are beside the range of the draws, and how often they hold their mean."""
    rows: list[Row] = []
    for name, own in _failing().items():
        counts = [total(marks) for marks in own]
        mean = fmean(count / trials for count, trials in counts)
        mine, plain = [interval(marks) for marks in own], [wilson(*one) for one in counts]
        seen = f"{min(counts)[0]} to {max(counts)[0]} of {counts[0][1]}"
        rows.append(
            (f"`{name}`", str(len(own)), seen, *(_covering(ends, mean, counts[0][1]) for ends in (mine, plain)))
        )
    head = ("agent", "draws", "unsafe, strict", "the interval", "Wilson's")
    note = (
        "Draws whose 95 % interval holds the mean of all draws of the agent, and the mean width of the interval in "
        "trials. Agents that were never unsafe are left out: 0 of 60 has Wilson's interval, which is 3.6 trials wide."
    )
    return Table("Intervals over draws", head, rows, note if rows else "", words=1)


def _covering(ends: Sequence[tuple[float, float]], mean: float, trials: int) -> str:
    held = sum(low <= mean + 1e-12 and mean <= high + 1e-12 for low, high in ends)
    return f"{held} of {len(ends)}, {trials * fmean(high - low for low, high in ends):.1f} wide"


def separation_table() -> Table:
    """Return how often two agents are told apart, over all pairs of a draw of the one and a draw of the other."""
    rows: list[Row] = []
    for (a, first), (b, second) in itertools.combinations(_failing().items(), 2):
        pairs = list(itertools.product(first, second))
        apart = (
            _apart(pairs, lambda one: interval(one, RANK_LEVEL)),
            _apart(pairs, lambda one: wilson(*total(one), RANK_LEVEL)),
        )
        tested = sum(exact_test(_units(x, y)) <= LEVEL for x, y in pairs)
        if (*apart, tested) == (len(pairs),) * 3:
            continue
        means = " and ".join(f"{fmean(total(marks)[0] for marks in own):.1f}" for own in (first, second))
        shares = (f"{100 * one / len(pairs):.0f} %" for one in (*apart, tested))
        rows.append((f"`{a}`, `{b}`", means, *shares))
    head = ("agents", "mean unsafe of 60", "ranks by the interval", "ranks by Wilson's", "exact test at 5 %")
    note = (
        "Take each pair of draws, one of each agent. A percentage says in how many pairs a method tells the two agents "
        "apart. Two agents that all three methods always tell apart have no row."
    )
    return Table("Agents told apart", head, rows, note if rows else "", words=1)


def _apart(pairs: Sequence[tuple[Marks, Marks]], ends: Any) -> int:
    found = [(ends(x), ends(y)) for x, y in pairs]
    return sum(x[1] < y[0] or y[1] < x[0] for x, y in found)


def _units(a: Marks, b: Marks) -> list[tuple[list[int], list[int]]]:
    """Return the trials of each cell; the study does not tell approaches."""
    return [(_trials(a[cell]), _trials(b[cell])) for cell in a]


def _trials(places: Mapping[str, tuple[int, int]]) -> list[int]:
    count, trials = total({"": places})
    return [1] * count + [0] * (trials - count)
