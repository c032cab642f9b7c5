"""Comparisons of two agents on a suite: exact, within strata."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

from wrongturn_judge.intervals import Units, exact_test
from wrongturn_protocol import AgentDetail, Comparison, Metrics, StratumComparison, TableCell
from wrongturn_protocol.intervals import LEVEL, Marks, is_drawn, town_of

Key = tuple[tuple[str, str], tuple[str, str]]
"""A row of the answer by its fields' names and values: junction type and fault, or task and condition of a journey."""


@dataclass(frozen=True)
class Side:
    """One of the two agents."""

    agent: AgentDetail
    metrics: Metrics
    why_not: str | None = None
    """Why it has no rank; None if it has one."""


def compare(suite: str, a: Side, b: Side) -> Comparison:
    """Compare two agents on one suite.

    The strict column is compared; of journeys, those that did not arrive. Raises ValueError if metrics have no marks.
    """
    left, right = _counts(a.metrics), _counts(b.metrics)
    none = TableCell(unsafe=0, trials=0)
    pairs = {key: (left.get(key, none), right.get(key, none)) for key in [*left, *right]}
    total_a, total_b = _total(left), _total(right)
    p = p_value(a.metrics, b.metrics)
    what = "missed its goal" if a.metrics.navigation is not None else "was unsafe"
    figures = (
        f"{a.agent.name} {what} in {total_a.unsafe} of {total_a.trials} trials, "
        f"{b.agent.name} in {total_b.unsafe} of {total_b.trials}"
    )
    verdict = "the difference is significant at 5 %" if p <= LEVEL else "the difference is not significant at 5 %"
    return Comparison(
        suite=suite,
        a=a.agent,
        b=b.agent,
        strata=tuple(StratumComparison.model_validate({**dict(key), "a": x, "b": y}) for key, (x, y) in pairs.items()),
        total_a=total_a,
        total_b=total_b,
        difference=total_a.unsafe / total_a.trials - total_b.unsafe / total_b.trials,
        p=p,
        sentence=" ".join([f"{figures}; {verdict} (p = {p:.2g}).", *_remarks(a, b)]),
    )


def p_value(a: Metrics, b: Metrics) -> float:
    """Return the two-sided p-value of the exact test of two agents. Raises ValueError if metrics have no marks."""
    if a.marks is None or b.marks is None:
        raise ValueError("marks: there are none; compute the metrics from the outcomes of an evaluation")
    return p_of_marks(a.marks, b.marks)


def p_of_marks(a: Marks, b: Marks) -> float:
    """Return the two-sided p-value of the exact test of two agents' marks."""
    return _p_value(*sorted((_frozen(a), _frozen(b))))


_Frozen = tuple[tuple[str, tuple[tuple[str, tuple[int, int]], ...]], ...]


def _frozen(marks: Marks) -> _Frozen:
    return tuple((stratum, tuple(places.items())) for stratum, places in marks.items())


@lru_cache(maxsize=8192)
def _p_value(a: _Frozen, b: _Frozen) -> float:
    return exact_test(_units(*({stratum: dict(places) for stratum, places in one} for one in (a, b))))


def _units(a: Marks, b: Marks) -> list[Units]:
    """Return the units that the exact test deals to the two agents.

    An approach that both drew is a stratum of its own, since an agent fails at some approaches and not at others. The
    other trials of a cell are a stratum. Drawn towns are dealt as a whole: trials in one town are not independent.
    """
    units: list[Units] = []
    for stratum in sorted({*a, *b}):
        if is_drawn(stratum):
            continue
        mine, theirs = a.get(stratum, {}), b.get(stratum, {})
        shared = mine.keys() & theirs.keys()
        differing = (place for place in shared if mine[place] != theirs[place] or mine[place][1] > 1)
        units += [(_trials(mine[place]), _trials(theirs[place])) for place in differing]
        rest = [[mark for k, v in one.items() if k not in shared for mark in _trials(v)] for one in (mine, theirs)]
        units.append((rest[0], rest[1]))
    towns: dict[tuple[str, ...], tuple[list[int], list[int]]] = defaultdict(lambda: ([], []))
    for side, marks in enumerate((a, b)):
        for cells, count in _drawn(marks):
            towns[cells][side].append(count)
    return [*units, *towns.values()]


def _trials(cell: tuple[int, int]) -> list[int]:
    count, trials = cell
    return [1] * count + [0] * (trials - count)


def _drawn(marks: Marks) -> list[tuple[tuple[str, ...], int]]:
    """Return the strata of the trials in each drawn town, and the number of those that are marked."""
    towns: dict[str, tuple[list[str], list[int]]] = defaultdict(lambda: ([], []))
    for stratum, places in marks.items():
        for place, (count, trials) in places.items() if is_drawn(stratum) else ():
            if (town := town_of(place)) is not None:
                towns[town][0].extend([stratum] * trials)
                towns[town][1].append(count)
    return [(tuple(sorted(strata)), sum(counts)) for strata, counts in towns.values()]


def _remarks(a: Side, b: Side) -> list[str]:
    """Return what a reader has to know beside the figures, in sentences."""
    remarks = []
    if a.agent.track is not b.agent.track:
        tracks = f"{a.agent.track} and {b.agent.track}"
        remarks.append(f"They drive in different tracks ({tracks}), which are never ranked together.")
    without = [side for side in (a, b) if side.why_not is not None]
    return [*remarks, *(f"{side.agent.name} has no rank: {side.why_not}" for side in without)]


def _counts(metrics: Metrics) -> dict[Key, TableCell]:
    if metrics.navigation is not None:
        return {
            (("task", task), ("condition", condition)): TableCell(
                unsafe=one.episodes - one.success, trials=one.episodes
            )
            for task, row in metrics.navigation.table.items()
            for condition, one in row.items()
        }
    return {
        (("junction_type", kind), ("fault", fault)): cell
        for kind, row in (metrics.table_strict or {}).items()
        for fault, cell in row.items()
        if cell.trials
    }


def _total(counts: Mapping[Key, TableCell]) -> TableCell:
    cells = counts.values()
    return TableCell(unsafe=sum(cell.unsafe for cell in cells), trials=sum(cell.trials for cell in cells))
