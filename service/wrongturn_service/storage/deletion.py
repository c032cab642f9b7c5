"""The steps of a deletion. Each is part of its caller's transaction."""

import time
from collections.abc import Sequence
from typing import Final

from sqlalchemy import delete, select, update
from sqlalchemy.ext.asyncio import AsyncSession

from wrongturn_protocol import EpisodeState, EvaluationState, SubmissionState
from wrongturn_protocol.administration import Contents
from wrongturn_protocol.vocabulary import Collection
from wrongturn_service.storage import held
from wrongturn_service.storage.contents import Scope, counted_episodes, replies_about, total
from wrongturn_service.storage.models import (
    AgentRow,
    AuditRow,
    EpisodeRow,
    EvaluationRow,
    HeldRow,
    IdempotencyRow,
    OwnerRow,
    ResultsRow,
    SubmissionLogRow,
    SubmissionRow,
    TrajectoryRow,
    UnusedSecretRow,
)

BATCH: Final = 100
"""Episodes that are deleted in one transaction, so that others can write in between."""
_REASON: Final = "deleted by the operator"


async def stop(session: AsyncSession, scope: Scope, cancelled: Sequence[str]) -> None:
    """Hide what is being deleted, end its tokens, and stop what runs."""
    now = time.time()
    await session.execute(update(OwnerRow).where(scope.owners).values(hidden=True, token_sha256=None))
    await session.execute(update(AgentRow).where(scope.agents).values(hidden=True, token_sha256=None))
    await session.execute(update(EvaluationRow).where(scope.evaluations).values(hidden=True))
    running = update(EvaluationRow).where(scope.evaluations, EvaluationRow.state == EvaluationState.RUNNING)
    await session.execute(running.values(state=EvaluationState.CANCELLED))
    driven = update(EpisodeRow).where(scope.episodes, EpisodeRow.state == EpisodeState.OPEN)
    await session.execute(driven.values(state=EpisodeState.LOST, finished=now))
    waiting = update(SubmissionRow).where(SubmissionRow.id.in_(cancelled))
    over = {"state": SubmissionState.CANCELLED, "token_sha256": None, "ended": now, "reason": _REASON}
    await session.execute(waiting.values(**over))


async def hold(session: AsyncSession, collection: Collection, item_id: str, scope: Scope) -> None:
    """Keep the names, and the place on a suite, of what is about to be deleted."""
    for row, where, kind in ((OwnerRow, scope.owners, held.OWNER), (AgentRow, scope.agents, held.AGENT)):
        for name in (await session.scalars(select(row.name_key).where(where))).all():
            await held.hold(session, kind, name, item_id)
    if collection is not Collection.EVALUATIONS:
        return
    evaluation = await session.get(EvaluationRow, item_id)
    if evaluation is None:
        return
    if evaluation.driven is None:
        # It never counted. The agent's next one gets its trials.
        secret = UnusedSecretRow(agent_id=evaluation.agent_id, suite=evaluation.suite, secret=evaluation.secret)
        await session.merge(secret)
        return
    of_agent = EvaluationRow.agent_id == evaluation.agent_id, EvaluationRow.suite == evaluation.suite
    begun = select(EvaluationRow.id).where(*of_agent, EvaluationRow.driven.is_not(None))
    if await session.scalar(begun.order_by(EvaluationRow.seq).limit(1)) == item_id:
        await held.hold(session, held.EVALUATION, held.place(evaluation.agent_id, evaluation.suite), item_id)


async def delete_episodes(session: AsyncSession, scope: Scope, entry: AuditRow) -> None:
    """Delete the episodes of a scope with their trajectories, and count them in an entry of the audit log."""
    note(entry, await counted_episodes(session, scope))
    await session.execute(delete(TrajectoryRow).where(scope.trajectories))
    await session.execute(delete(EpisodeRow).where(scope.episodes))


async def delete_replies(
    session: AsyncSession, scope: Scope, collection: Collection, item_id: str, entry: AuditRow
) -> None:
    """Delete the stored replies about an item, and count them in an entry of the audit log."""
    for name, keys in (await replies_about(session, scope, collection, item_id)).items():
        note(entry, Contents(replies=len(keys), bytes=sum(keys.values())))
        hashes = list(keys)
        for at in range(0, len(hashes), BATCH):
            some = IdempotencyRow.key_sha256.in_(hashes[at : at + BATCH])
            await session.execute(delete(IdempotencyRow).where(IdempotencyRow.scope == name, some))


async def delete_rest(session: AsyncSession, scope: Scope) -> None:
    """Delete all but episodes and replies, what refers to others first."""
    await session.execute(delete(ResultsRow).where(scope.results))
    submissions = select(SubmissionRow.id).where(scope.submissions)
    await session.execute(delete(SubmissionLogRow).where(SubmissionLogRow.submission_id.in_(submissions)))
    await session.execute(delete(SubmissionRow).where(scope.submissions))
    # By their ids: the conditions ask for rows that are gone by then.
    agents = (await session.scalars(select(AgentRow.id).where(scope.agents))).all()
    owners = (await session.scalars(select(OwnerRow.id).where(scope.owners))).all()
    await session.execute(delete(EvaluationRow).where(scope.evaluations))
    for agent in agents:  # which has no secrets and places any more
        await session.execute(delete(UnusedSecretRow).where(UnusedSecretRow.agent_id == agent))
        places = HeldRow.kind == held.EVALUATION, HeldRow.key.startswith(f"{agent} ", autoescape=True)
        await session.execute(delete(HeldRow).where(*places))
        await session.execute(delete(AgentRow).where(AgentRow.id == agent))
    await session.execute(delete(OwnerRow).where(OwnerRow.id.in_(owners)))


async def entry_of(session: AsyncSession, seq: int) -> AuditRow:
    """Return an entry of the audit log by its number."""
    entry = await session.get(AuditRow, seq)
    assert entry is not None
    return entry


def note(entry: AuditRow, *deleted: Contents) -> None:
    """Add what was deleted to an entry of the audit log."""
    entry.counts = total(Contents.model_validate_json(entry.counts), *deleted).model_dump_json(exclude_defaults=True)
