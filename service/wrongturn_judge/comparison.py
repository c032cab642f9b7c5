"""Comparisons of two agents on a suite: exact, within strata."""

from collections.abc import Mapping
from dataclasses import dataclass

from wrongturn_judge.intervals import LEVEL, stratified_exact
from wrongturn_judge.metrics import SuiteLike, is_success, of_journeys
from wrongturn_protocol import AgentDetail, Comparison, Condition, Outcome, StratumComparison, TableCell, Trial

Key = tuple[tuple[str, str], tuple[str, str]]
"""A stratum by its fields' names and values: junction type and fault, or task and condition of a journey."""


@dataclass(frozen=True)
class Side:
    """One of the two agents."""

    agent: AgentDetail
    draw: SuiteLike
    """Trials of its evaluation, which no other evaluation has."""
    outcomes: Mapping[str, Outcome]
    """By trial id. A trial without one was left unfinished and counts as unsafe."""
    why_not: str | None = None
    """Why it has no rank; None if it has one."""


def compare(a: Side, b: Side) -> Comparison:
    """Compare two agents on one suite.

    Trials of two evaluations are never paired: each evaluation draws its own. Counts are compared within strata, of
    which every evaluation has the same number of trials. For journeys the trials that did not arrive are counted.
    """
    journeys = of_journeys(a.draw)
    left, right = _counts(a, journeys=journeys), _counts(b, journeys=journeys)
    none = TableCell(unsafe=0, trials=0)
    pairs = {key: (left.get(key, none), right.get(key, none)) for key in [*left, *right]}
    total_a, total_b = _total(left), _total(right)
    p = stratified_exact([(x.unsafe, x.trials, y.unsafe, y.trials) for x, y in pairs.values()])
    what = "missed its goal" if journeys else "was unsafe"
    figures = (
        f"{a.agent.name} {what} in {total_a.unsafe} of {total_a.trials} trials, "
        f"{b.agent.name} in {total_b.unsafe} of {total_b.trials}"
    )
    verdict = "the difference is significant at 5 %" if p <= LEVEL else "the difference is not significant at 5 %"
    return Comparison(
        suite=a.draw.id,
        a=a.agent,
        b=b.agent,
        strata=tuple(StratumComparison.model_validate({**dict(key), "a": x, "b": y}) for key, (x, y) in pairs.items()),
        total_a=total_a,
        total_b=total_b,
        difference=total_a.unsafe / total_a.trials - total_b.unsafe / total_b.trials,
        p=p,
        sentence=" ".join([f"{figures}; {verdict} (p = {p:.2g}).", *_remarks(a, b)]),
    )


def _remarks(a: Side, b: Side) -> list[str]:
    """Return what a reader has to know beside the figures, in sentences."""
    remarks = []
    if a.agent.track is not b.agent.track:
        tracks = f"{a.agent.track} and {b.agent.track}"
        remarks.append(f"They drive in different tracks ({tracks}), which are never ranked together.")
    without = [side for side in (a, b) if side.why_not is not None]
    return [*remarks, *(f"{side.agent.name} has no rank: {side.why_not}" for side in without)]


def _counts(side: Side, *, journeys: bool) -> dict[Key, TableCell]:
    marks: dict[Key, list[bool]] = {}
    for trial in side.draw.trials:
        outcome = side.outcomes.get(trial.id)
        failed = outcome is None or (not is_success(outcome) if journeys else outcome.unsafe_strict)
        marks.setdefault(_key(trial), []).append(failed)
    return {key: TableCell(unsafe=sum(found), trials=len(found)) for key, found in marks.items()}


def _key(trial: Trial) -> Key:
    if trial.journey is None:
        return ("junction_type", trial.junction_type), ("fault", trial.fault.kind)
    return ("task", trial.journey.task), ("condition", Condition.of(trial.town, trial.weather))


def _total(counts: Mapping[Key, TableCell]) -> TableCell:
    cells = counts.values()
    return TableCell(unsafe=sum(cell.unsafe for cell in cells), trials=sum(cell.trials for cell in cells))
