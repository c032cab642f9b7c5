"""Deletes what nobody needs any more, in the caller's transaction."""

from sqlalchemy import delete, func, select
from sqlalchemy.ext.asyncio import AsyncSession

from wrongturn_protocol import EpisodeState, EvaluationState
from wrongturn_service.storage.models import (
    AgentRow,
    EpisodeRow,
    EvaluationRow,
    IdempotencyRow,
    OwnerRow,
    ResultsRow,
    SubmissionRow,
    UnusedSecretRow,
)
from wrongturn_service.storage.usage import ROW, Usage


async def delete_abandoned(session: AsyncSession, usage: Usage, before: float) -> None:
    """Delete lost episodes, and the episodes and records of cancelled evaluations. Their rows stay.

    Args:
        session: The transaction.
        usage: Counts bytes.
        before: When they have to have ended, seconds since 1970.
    """
    over = select(EvaluationRow.id).where(EvaluationRow.state != EvaluationState.RUNNING)
    lost = EpisodeRow.state == EpisodeState.LOST, EpisodeRow.finished < before
    await usage.delete_episodes(session, EpisodeRow.evaluation_id.in_(over), *lost)
    last = select(func.max(EpisodeRow.finished)).where(EpisodeRow.evaluation_id == EvaluationRow.id)
    cancelled = select(EvaluationRow.id).where(
        EvaluationRow.state == EvaluationState.CANCELLED, last.scalar_subquery() < before
    )
    for evaluation in (await session.scalars(cancelled)).all():
        await usage.delete_episodes(session, EpisodeRow.evaluation_id == evaluation)
        await session.execute(delete(ResultsRow).where(ResultsRow.evaluation_id == evaluation))
        await usage.settle_evaluation(session, evaluation, ROW)


async def delete_unused(session: AsyncSession, usage: Usage, before: float) -> None:
    """Delete owners who registered themselves and never drove what counts, with their agents and practice.

    Args:
        session: The transaction.
        usage: Counts bytes.
        before: When something has to have been stored for them last, seconds since 1970.
    """
    evaluated = select(EvaluationRow.id).join_from(EvaluationRow, AgentRow).where(AgentRow.owner_id == OwnerRow.id)
    handed_in = select(SubmissionRow.id).where(SubmissionRow.owner_id == OwnerRow.id)
    driving = (
        select(EpisodeRow.id)
        .join_from(EpisodeRow, AgentRow)
        .where(AgentRow.owner_id == OwnerRow.id, EpisodeRow.state == EpisodeState.OPEN)
    )
    unused = select(OwnerRow.id).where(
        OwnerRow.origin.is_not(None),
        OwnerRow.active < before,
        ~evaluated.exists(),
        ~handed_in.exists(),
        ~driving.exists(),
    )
    for owner in (await session.scalars(unused)).all():
        agents = select(AgentRow.id).where(AgentRow.owner_id == owner)
        await usage.delete_episodes(session, EpisodeRow.agent_id.in_(agents))
        await usage.delete_replies(session, IdempotencyRow.owner_id == owner)
        await session.execute(delete(UnusedSecretRow).where(UnusedSecretRow.agent_id.in_(agents)))
        await session.execute(delete(AgentRow).where(AgentRow.owner_id == owner))
        await session.execute(delete(OwnerRow).where(OwnerRow.id == owner))
