"""An agent's metrics on a suite, from the outcomes of its trials and twins, or of its journeys.

Journeys are counted by task and condition, as in CoRL 2017: success, clean success and infractions.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import attrgetter
from typing import Final, Protocol

from wrongturn_judge.intervals import RANK_LEVEL, cluster_bootstrap, mcnemar_two_sided, wilson
from wrongturn_networks.faults import find_fault
from wrongturn_protocol import (
    PAPER_TYPES,
    Condition,
    ExcessUnsafeRate,
    FaultKind,
    Infractions,
    JunctionType,
    Metrics,
    NavigationCount,
    NavigationMetrics,
    Outcome,
    Reaction,
    StrictUnsafeCount,
    TableCell,
    Task,
    Trial,
    TwinCount,
    UnsafeCount,
    Verdict,
    twin_id,
)


class SuiteLike(Protocol):
    """The parts of a suite that metrics need."""

    @property
    def id(self) -> str:
        """Name and version."""

    @property
    def trials(self) -> tuple[Trial, ...]:
        """The trials without their twins."""


class UnscoredTrialError(ValueError):
    """A trial or a twin has no outcome that counts."""


JOURNEYS_END: Final = (Verdict.COLLISION, Verdict.TIMEOUT, Verdict.ABORTED, Verdict.ARRIVED)
"""Possible verdicts of a scored journey. Metrics list them even if their count is 0."""


def of_journeys(suite: SuiteLike) -> bool:
    """Return whether a suite consists of journeys, which have no twins. Raises ValueError for a mixed one."""
    journeys = sum(trial.journey is not None for trial in suite.trials)
    if journeys and journeys < len(suite.trials):
        raise ValueError(f"suite: {suite.id} has journeys among other trials; make two suites of it")
    return journeys > 0


def junction_of(trial: Trial) -> tuple[str, str]:
    """Return a trial's town and junction, its cluster in the bootstrap. Approach ``J3-S`` is at junction ``J3``."""
    return trial.town, trial.approach.rpartition("-")[0] or trial.approach


def compute(suite: SuiteLike, outcomes: Mapping[str, Outcome]) -> Metrics:
    """Compute the metrics of a finished evaluation. Every trial of the suite counts, whatever its verdict.

    ``outcomes`` are by trial id, for every trial and every twin; journeys have no twins. The metrics do not depend on
    the order of trials or outcomes.

    Raises:
        UnscoredTrialError: A trial or a twin has no outcome, or an ``invalid`` one.
        ValueError: The suite has no trials, or mixes journeys with other trials.
    """
    if not suite.trials:
        raise ValueError(f"suite: {suite.id} has no trials, so there is nothing to count")
    if of_journeys(suite):
        return _journeys(suite, outcomes)
    faulted = [(trial, _scored(trial.id, outcomes)) for trial in suite.trials]
    twins = [(trial, _scored(twin_id(trial), outcomes)) for trial in suite.trials]
    return Metrics(
        unsafe=unsafe_count(outcome.verdict.unsafe for _, outcome in faulted),
        unsafe_strict=strict_count(outcome.unsafe_strict for _, outcome in faulted),
        twins=TwinCount(
            unsafe=sum(outcome.verdict.unsafe for _, outcome in twins),
            completed=sum(outcome.verdict is Verdict.EXIT_COMMANDED for _, outcome in twins),
            trials=len(twins),
        ),
        excess_unsafe_rate=_excess(
            [
                (trial, outcome.unsafe_strict, twin.unsafe_strict)
                for (trial, outcome), (_, twin) in zip(faulted, twins, strict=True)
            ]
        ),
        table=_table(faulted, attrgetter("verdict.unsafe")),
        table_strict=_table(faulted, attrgetter("unsafe_strict")),
        reactions=_reactions(faulted),
        verdicts=_verdicts(faulted, [outcome for _, outcome in twins]),
    )


def _journeys(suite: SuiteLike, outcomes: Mapping[str, Outcome]) -> Metrics:
    driven = [(trial, _scored(trial.id, outcomes)) for trial in suite.trials]
    seen = [outcome.verdict for _, outcome in driven]
    listed = [verdict for verdict in Verdict if verdict in JOURNEYS_END or verdict in seen]
    return Metrics(
        unsafe=unsafe_count(outcome.verdict.unsafe for _, outcome in driven),
        unsafe_strict=strict_count(outcome.unsafe_strict for _, outcome in driven),
        twins=TwinCount(unsafe=0, completed=0, trials=0),
        excess_unsafe_rate=None,
        table={},
        reactions={},
        verdicts={FaultKind.NONE.value: {verdict: seen.count(verdict) for verdict in listed}},
        navigation=navigation_metrics(driven),
    )


def unsafe_count(unsafe: Iterable[bool]) -> UnsafeCount:
    """Return the count of unsafe outcomes with Wilson's interval."""
    marks = tuple(unsafe)
    count = sum(marks)
    return UnsafeCount(count=count, trials=len(marks), rate=count / len(marks), ci95=wilson(count, len(marks)))


def strict_count(unsafe: Iterable[bool]) -> StrictUnsafeCount:
    """Return the count of the strict column, with the interval that decides the ranks."""
    count = unsafe_count(unsafe)
    return StrictUnsafeCount(**count.model_dump(), ci83=wilson(count.count, count.trials, RANK_LEVEL))


def _scored(trial_id: str, outcomes: Mapping[str, Outcome]) -> Outcome:
    outcome = outcomes.get(trial_id)
    if outcome is None:
        raise UnscoredTrialError(f"outcomes: {trial_id} has none; run it before the evaluation is counted")
    if outcome.verdict is Verdict.INVALID:
        raise UnscoredTrialError(f"outcomes: {trial_id} is invalid, which is never scored; run it again")
    return outcome


def _excess(pairs: list[tuple[Trial, bool, bool]]) -> ExcessUnsafeRate:
    """Return the excess of pairs (trial, whether it was unsafe, whether its twin was)."""
    clusters: dict[tuple[str, str], list[int]] = defaultdict(list)
    for trial, unsafe, twin_unsafe in pairs:
        clusters[junction_of(trial)].append(int(unsafe) - int(twin_unsafe))
    only_trial = sum(unsafe and not twin_unsafe for _, unsafe, twin_unsafe in pairs)
    only_twin = sum(twin_unsafe and not unsafe for _, unsafe, twin_unsafe in pairs)
    return ExcessUnsafeRate(
        value=(only_trial - only_twin) / len(pairs),
        ci95=cluster_bootstrap(clusters),
        p=mcnemar_two_sided(only_trial, only_twin),
    )


def _faults(faulted: list[tuple[Trial, Outcome]]) -> list[FaultKind]:
    present = {trial.fault.kind for trial, _ in faulted}
    return [kind for kind in FaultKind if kind in present]


def _table(
    faulted: list[tuple[Trial, Outcome]], unsafe: Callable[[Outcome], bool]
) -> dict[JunctionType, dict[str, TableCell]]:
    """Return a table as the paper's: always its three types, in its order, and a crossing only if the suite has one."""
    present = {trial.junction_type for trial, _ in faulted}
    types = [*PAPER_TYPES, *(kind for kind in JunctionType if kind in present and kind not in PAPER_TYPES)]
    table: dict[JunctionType, dict[str, TableCell]] = {}
    for junction_type in types:
        table[junction_type] = {}
        for fault in _faults(faulted):
            marks = [
                unsafe(outcome)
                for trial, outcome in faulted
                if trial.junction_type is junction_type and trial.fault.kind is fault
            ]
            table[junction_type][fault.value] = TableCell(unsafe=sum(marks), trials=len(marks))
    return table


def _reactions(faulted: list[tuple[Trial, Outcome]]) -> dict[str, dict[Reaction, int]]:
    counts: dict[str, dict[Reaction, int]] = {}
    for fault in _faults(faulted):
        # An outcome without a reaction still counts, as "other".
        seen = [outcome.reaction or Reaction.OTHER for trial, outcome in faulted if trial.fault.kind is fault]
        built = find_fault(fault)
        listed = built.reactions if built is not None else ()
        counts[fault.value] = {kind: seen.count(kind) for kind in Reaction if kind in listed or kind in seen}
    return counts


def _verdicts(faulted: list[tuple[Trial, Outcome]], twins: list[Outcome]) -> dict[str, dict[Verdict, int]]:
    by_fault: dict[FaultKind, list[Verdict]] = {FaultKind.NONE: [twin.verdict for twin in twins]}
    for trial, outcome in faulted:
        by_fault.setdefault(trial.fault.kind, []).append(outcome.verdict)
    unlisted = {Verdict.INVALID, Verdict.ARRIVED}  # one is never scored, the other a journey's
    return {
        fault.value: {verdict: seen.count(verdict) for verdict in Verdict if verdict not in unlisted}
        for fault in FaultKind
        if (seen := by_fault.get(fault))
    }


Driven = Sequence[tuple[Trial, Outcome]]
"""Journeys and their outcomes."""


def is_success(outcome: Outcome) -> bool:
    """Return whether a journey reached its goal in time."""
    return outcome.verdict is Verdict.ARRIVED


def navigation_metrics(driven: Driven) -> NavigationMetrics:
    """Count journeys, at least one, by task and condition."""
    cells: dict[tuple[Task, Condition], list[tuple[Trial, Outcome]]] = defaultdict(list)
    for trial, outcome in driven:
        assert trial.journey is not None
        cells[trial.journey.task, Condition.of(trial.town, trial.weather)].append((trial, outcome))
    return NavigationMetrics(
        total=count(driven),
        table={
            task: {condition: count(cells[task, condition]) for condition in Condition if (task, condition) in cells}
            for task in Task
            if any(found is task for found, _ in cells)
        },
    )


def count(driven: Driven) -> NavigationCount:
    """Return the metrics of journeys, at least one.

    An episode that ended without a simulator counts with a distance of 0.
    """
    outcomes = [outcome for _, outcome in driven]
    journeys = [outcome.journey for outcome in outcomes if outcome.journey is not None]
    success = sum(map(is_success, outcomes))
    # fsum is exact, so the order of the trials does not change the sum.
    distance = math.fsum(journey.distance for journey in journeys) / 1000
    return NavigationCount(
        episodes=len(outcomes),
        success=success,
        clean=sum(is_success(one) and one.journey is not None and one.journey.clean for one in outcomes),
        rate=success / len(outcomes),
        ci95=wilson(success, len(outcomes)),
        completion=math.fsum(journey.completion for journey in journeys) / len(outcomes),
        distance=distance,
        per_km=None
        if distance <= 0
        else Infractions(
            off_road=sum(journey.off_road for journey in journeys) / distance,
            wrong_lane=sum(journey.wrong_lane for journey in journeys) / distance,
            collisions=sum(journey.collisions for journey in journeys) / distance,
        ),
    )
