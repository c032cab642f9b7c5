"""How agents stand to one another on a suite."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from wrongturn_protocol import AgentDetail, Entry, LeaderboardEntry, Metrics, Outcome, Track, Verdict
from wrongturn_service.evaluation.metrics import SuiteLike, is_unsafe, of_journeys
from wrongturn_service.evaluation.navigation import is_success
from wrongturn_service.evaluation.statistics import holm_rejections, mcnemar_one_sided

TRACK_ORDER: Final = (Track.CAMERA, Track.SEGMENTATION, Track.PRIVILEGED, Track.STATE)
"""In which tracks follow one another on a leaderboard."""


@dataclass(frozen=True)
class RankingInput:
    """One finished evaluation that stands on a leaderboard.

    Attributes:
        agent: whose it is.
        evaluation: its id.
        entry: how the agent was driven.
        outcomes: by trial id, for every trial of the suite.
        metrics: what :func:`~wrongturn_service.evaluation.metrics.compute` made of them.
        cancelled: how many evaluations on the suite the agent began to drive and cancelled.
    """

    agent: AgentDetail
    evaluation: str
    entry: Entry
    outcomes: Mapping[str, Outcome]
    metrics: Metrics
    cancelled: int = 0


def least_completed(trials: int) -> int:
    """How many twins of so many must be completed for a rank: nine in ten, 54 of 60."""
    return -(-trials * 9 // 10)


def most_not_engaged(trials: int) -> int:
    """In how many trials of so many an agent may stay away from the junction: one in twenty, 3 of 60."""
    return trials // 20


def why_not(suite: SuiteLike, row: RankingInput) -> str | None:
    """Why an evaluation has no rank, as a sentence; None where it has one, as each on a suite of journeys."""
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
    """Order a suite's evaluations.

    A rank is 1 plus the number of ranked agents of the same track that are significantly better: exact McNemar over
    the trials in the paper's column, one-sided, corrected by Holm over the agent's comparisons. Of journeys those are
    compared that did not reach their goal.

    Args:
        suite: the suite that they are of.
        rows: one finished evaluation per agent.

    Returns:
        LogEntries by track; in each the ranked by rank, unsafe count and name, then the others by twins completed,
        unsafe count and name. Journeys: by rank, goals reached, those without infractions, and name.
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
    """Rank by evaluation, within one track."""
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
