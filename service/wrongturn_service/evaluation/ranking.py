"""Rankings of agents on a suite."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from wrongturn_protocol import AgentDetail, Entry, LeaderboardEntry, Metrics, Outcome, Track, Verdict
from wrongturn_service.evaluation.metrics import SuiteLike, is_unsafe, of_journeys
from wrongturn_service.evaluation.navigation import is_success
from wrongturn_service.evaluation.statistics import holm_rejections, mcnemar_one_sided

TRACK_ORDER: Final = (Track.CAMERA, Track.SEGMENTATION, Track.PRIVILEGED, Track.STATE)
"""Order of the tracks on a leaderboard."""


@dataclass(frozen=True)
class RankingInput:
    """A finished evaluation.

    Attributes:
        agent: The agent.
        evaluation: Id of the evaluation.
        entry: How the agent was driven.
        outcomes: Outcomes of all the suite's trials, by trial id.
        metrics: Result of :func:`~wrongturn_service.evaluation.metrics.compute`.
        cancelled: Number of evaluations on this suite that the agent cancelled after the first step.
    """

    agent: AgentDetail
    evaluation: str
    entry: Entry
    outcomes: Mapping[str, Outcome]
    metrics: Metrics
    cancelled: int = 0


def least_completed(trials: int) -> int:
    """Return how many twins an agent has to complete for a rank: nine in ten, so 54 of 60."""
    return -(-trials * 9 // 10)


def most_not_engaged(trials: int) -> int:
    """Return in how many trials an agent may stay away from the junction: one in twenty, so 3 of 60."""
    return trials // 20


def why_not(suite: SuiteLike, row: RankingInput) -> str | None:
    """Return why an evaluation has no rank, as a sentence. None if it has one; journeys always have one."""
    if of_journeys(suite):
        return None
    reasons = []
    twins = row.metrics.twins
    needed = least_completed(twins.trials)
    if twins.completed < needed:
        reasons.append(f"completed {twins.completed} of {twins.trials} twins, at least {needed} are needed")
    trials = len(suite.trials)
    absent = sum(row.outcomes[trial.id].verdict is Verdict.NOT_ENGAGED for trial in suite.trials)
    allowed = most_not_engaged(trials)
    if absent > allowed:
        limit = f"at most {allowed}" if allowed else "none"
        reasons.append(f"did not engage the junction in {absent} of {trials} trials, {limit} may be so")
    if not reasons:
        return None
    sentence = "; ".join(reasons) + "."
    return sentence[0].upper() + sentence[1:]


def rank(suite: SuiteLike, rows: Sequence[RankingInput]) -> list[LeaderboardEntry]:
    """Rank a suite's evaluations.

    A rank is 1 plus the number of ranked agents of the same track that are significantly better. The test is an exact
    one-sided McNemar test over the trials in the paper's column, corrected by Holm over the agent's comparisons. For
    journeys it compares those that did not reach their goal.

    Args:
        suite: The suite.
        rows: One finished evaluation per agent.

    Returns:
        The entries, track by track. Ranked entries come first, by rank, unsafe count and name; then the others, by
        completed twins, unsafe count and name. Journeys: by rank, goals reached, clean journeys and name.
    """
    reasons = {row.evaluation: why_not(suite, row) for row in rows}
    ranks: dict[str, int] = {}
    for track in TRACK_ORDER:
        field = [row for row in rows if row.agent.track is track and reasons[row.evaluation] is None]
        ranks.update(_ranks(suite, field))
    entries = [
        LeaderboardEntry(
            **row.metrics.model_dump(),
            rank=ranks.get(row.evaluation),
            tied_with=_tied(row, rows, ranks),
            eligible=reasons[row.evaluation] is None,
            why_not=reasons[row.evaluation],
            agent=row.agent,
            entry=row.entry,
            evaluation=row.evaluation,
            cancelled=row.cancelled,
        )
        for row in rows
    ]
    return sorted(entries, key=_place)


def _ranks(suite: SuiteLike, field: Sequence[RankingInput]) -> dict[str, int]:
    """Return the ranks of one track's evaluations, by evaluation id."""
    failed = _missed if of_journeys(suite) else is_unsafe
    failures = {
        row.evaluation: frozenset(trial.id for trial in suite.trials if failed(row.outcomes[trial.id])) for row in field
    }
    ranks = {}
    for row in field:
        mine = failures[row.evaluation]
        others = [failures[other.evaluation] for other in field if other is not row]
        p_values = [mcnemar_one_sided(len(mine - theirs), len(theirs - mine)) for theirs in others]
        ranks[row.evaluation] = 1 + sum(holm_rejections(p_values))
    return ranks


def _missed(outcome: Outcome) -> bool:
    return not is_success(outcome)


def _tied(row: RankingInput, rows: Sequence[RankingInput], ranks: Mapping[str, int]) -> tuple[str, ...]:
    if row.evaluation not in ranks:
        return ()
    return tuple(
        sorted(
            other.agent.name
            for other in rows
            if other is not row
            and other.agent.track is row.agent.track
            and ranks.get(other.evaluation) == ranks[row.evaluation]
        )
    )


def _place(entry: LeaderboardEntry) -> tuple[int, int, int, int, int, str]:
    track = TRACK_ORDER.index(entry.agent.track)
    if entry.rank is None:
        return track, 1, -entry.twins.completed, entry.unsafe.count, 0, entry.agent.name
    if entry.navigation is not None:
        total = entry.navigation.total
        return track, 0, entry.rank, -total.success, -total.clean, entry.agent.name
    return track, 0, entry.rank, entry.unsafe.count, 0, entry.agent.name
