"""All queries of the service, one method each. Rows are detached: read them, do not change them."""

from sqlalchemy import Delete, delete, func, select

from wrongturn_protocol import EpisodeState, EvaluationState
from wrongturn_service.storage.accounts import AccountStore
from wrongturn_service.storage.episodes import EpisodeStore
from wrongturn_service.storage.evaluations import EvaluationStore
from wrongturn_service.storage.models import (
    AgentRow,
    EpisodeRow,
    EvaluationRow,
    IdempotencyRow,
    OwnerRow,
    ResultsRow,
    SubmissionRow,
)
from wrongturn_service.storage.usage import over_practice


class Store(AccountStore, EvaluationStore, EpisodeStore):
    """Reads and writes the database. Each method is one transaction.

    Methods that create something also take the reply for the idempotency key, so that both are stored or neither is.
    """

    @property
    def trouble(self) -> str | None:
        """Why the database cannot be used now, as a sentence; None if nothing is known against it."""
        return self._database.condition.trouble

    async def ping(self) -> None:
        """Query the database. Raises SQLAlchemy's errors if it does not answer or belongs to another service."""
        async with self._database.read() as session:
            self._database.check()
            await session.execute(select(1))

    async def reply(self, scope: str, key_sha256: str) -> IdempotencyRow | None:
        """Return the stored reply to a request with this key, or None."""
        return await self._get(IdempotencyRow, (scope, key_sha256))

    async def purge(
        self, *, practice_before: float, replies_before: float, abandoned_before: float, unused_before: float
    ) -> None:
        """Delete what is older than these times, seconds since 1970: practice, and replies to idempotency keys.

        What is ``abandoned`` are lost episodes, and all episodes and records of cancelled evaluations. The ``unused``
        are owners who registered themselves and have no evaluation and no submission, with their agents.
        """
        practice = delete(EpisodeRow).where(*over_practice(), EpisodeRow.finished < practice_before)
        replies = delete(IdempotencyRow).where(IdempotencyRow.created < replies_before)
        await self._write(practice, replies, *_abandoned(abandoned_before), _unused(unused_before))


def _abandoned(before: float) -> list[Delete]:
    """Return what deletes the lost episodes of evaluations that are over, and all that cancelled evaluations hold."""
    over = select(EvaluationRow.id).where(EvaluationRow.state != EvaluationState.RUNNING)
    lost = EpisodeRow.state == EpisodeState.LOST, EpisodeRow.finished < before
    last = select(func.max(EpisodeRow.finished)).where(EpisodeRow.evaluation_id == EvaluationRow.id)
    cancelled = select(EvaluationRow.id).where(
        EvaluationRow.state == EvaluationState.CANCELLED, last.scalar_subquery() < before
    )
    return [
        delete(EpisodeRow).where(EpisodeRow.evaluation_id.in_(over), *lost),
        delete(ResultsRow).where(ResultsRow.evaluation_id.in_(cancelled)),
        delete(EpisodeRow).where(EpisodeRow.evaluation_id.in_(cancelled)),
    ]


def _unused(before: float) -> Delete:
    """Return what deletes owners who registered themselves and never drove what counts."""
    evaluated = select(EvaluationRow.id).join_from(EvaluationRow, AgentRow).where(AgentRow.owner_id == OwnerRow.id)
    handed_in = select(SubmissionRow.id).where(SubmissionRow.owner_id == OwnerRow.id)
    driving = (
        select(EpisodeRow.id)
        .join_from(EpisodeRow, AgentRow)
        .where(AgentRow.owner_id == OwnerRow.id, EpisodeRow.state == EpisodeState.OPEN)
    )
    return delete(OwnerRow).where(
        OwnerRow.origin.is_not(None),
        OwnerRow.active < before,
        ~evaluated.exists(),
        ~handed_in.exists(),
        ~driving.exists(),
    )
