"""All queries of the service, one method each. Rows are detached: read them, do not change them."""

from sqlalchemy import select

from wrongturn_service.storage import purging
from wrongturn_service.storage.accounts import AccountStore
from wrongturn_service.storage.episodes import EpisodeStore
from wrongturn_service.storage.evaluations import EvaluationStore
from wrongturn_service.storage.models import EpisodeRow, IdempotencyRow
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
        async with self._database.read() as session:
            return await session.get(IdempotencyRow, (scope, key_sha256))

    async def purge(
        self, *, practice_before: float, replies_before: float, abandoned_before: float, unused_before: float
    ) -> None:
        """Delete what is old. All times are seconds since 1970.

        Args:
            practice_before: Practice that was over before.
            replies_before: Replies to idempotency keys that were stored before.
            abandoned_before: Lost episodes, and all episodes and records of cancelled evaluations, from before.
            unused_before: Owners who registered themselves, have no evaluation and no submission, and have stored
                nothing since; with their agents.
        """
        async with self._database.write() as session:
            await self._usage.delete_episodes(session, *over_practice(), EpisodeRow.finished < practice_before)
            await self._usage.delete_replies(session, IdempotencyRow.created < replies_before)
            await purging.delete_abandoned(session, self._usage, abandoned_before)
            await purging.delete_unused(session, self._usage, unused_before)
