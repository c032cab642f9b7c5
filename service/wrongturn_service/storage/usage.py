"""Bytes that are stored for owners, and what each owner and address may have.

Each row that belongs to an owner has its size in the column ``stored_bytes``, and an owner has the sum of them. Both
change in the transaction that stores or deletes the row. What is still growing is counted at what it may become: an
episode of practice until it ends, an evaluation until it is finished.
"""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import ColumnElement, Select, delete, func, select, update
from sqlalchemy.ext.asyncio import AsyncSession

from wrongturn_protocol import EpisodeState, Trial
from wrongturn_protocol.reserved_names import OWNER_NAME
from wrongturn_service.errors import QuotaReachedError
from wrongturn_service.storage.models import (
    AgentRow,
    EpisodeRow,
    EvaluationRow,
    IdempotencyRow,
    OwnerRow,
    ResultsRow,
    SubmissionRow,
    TrajectoryRow,
)

ROW: Final = 1024
"""Bytes that a row takes beside its texts: its ids and its entries in indexes."""
TRAJECTORY_ROW: Final = 4096
"""Bytes that a trajectory's row takes beside its data, with the rest of its last page."""
EPISODE_RESERVE: Final = 64 * 1024
"""Bytes that an episode at one junction can come to."""
JOURNEY_RESERVE: Final = 512 * 1024
"""Bytes that a journey can come to."""
REPLY_RESERVE: Final = 56 * 1024
"""Bytes of the stored reply to a reset, whose picture is the largest part."""
SUBMISSION: Final = 8 * 1024
"""Bytes that a submission takes beside its model: its row and its log."""
_BATCH: Final = 200
_UNLIMITED: Final = 1 << 62


@dataclass(frozen=True)
class Quota:
    """What an owner and an address may have.

    Attributes:
        owner_bytes: Stored bytes of one owner.
        address_bytes: Stored bytes of all owners that registered from one address.
        agents: Agents of one owner.
        accounts: Owners and agents that registered from one address.
    """

    owner_bytes: int = _UNLIMITED
    address_bytes: int = _UNLIMITED
    agents: int = _UNLIMITED
    accounts: int = _UNLIMITED


@dataclass(frozen=True)
class _Reached:
    """A quota of bytes, and what would be stored with some bytes more.

    Attributes:
        whose: The owner or the address, in words.
        setting: The quota's setting.
        stored: Bytes that are stored.
        more: Bytes that are wanted.
        most: Bytes that may be stored.
    """

    whose: str
    setting: str
    stored: int
    more: int
    most: int

    @property
    def over(self) -> int:
        """Bytes that would be too many; 0 or less if all fit."""
        return self.stored + self.more - self.most

    def sentence(self, *, reserve: bool) -> str:
        """Return what is said to who wanted the bytes, which may be the reserve of an evaluation."""
        wanted = f"{_megabytes(self.more)} more do not fit" if self.more else "nothing more fits"
        if reserve:
            wanted = (
                f"an evaluation reserves {_megabytes(self.more)}, which do not fit now (at its end it keeps only what "
                "it stored, and the rest comes back)"
            )
        return (
            f"{wanted}: {self.whose} has {_megabytes(self.stored)} of {_megabytes(self.most)}, its quota; finish or "
            "cancel running evaluations, wait until practice, models and stored replies are deleted with time, or ask "
            f"the operator to raise {self.setting}"
        )


class Usage:
    """Counts what owners have. Each method works in the caller's transaction."""

    def __init__(self, quota: Quota | None = None) -> None:
        self._quota = quota or Quota()

    async def add(self, session: AsyncSession, owner_id: str, more: int, *, now: float | None = None) -> None:
        """Count stored bytes of an owner, or deleted ones if ``more`` is negative. There is no check.

        Args:
            session: The transaction.
            owner_id: Id of the owner.
            more: Bytes.
            now: Seconds since 1970 if the owner does something now. None if the service does.
        """
        values: dict[str, Any] = {"stored_bytes": OwnerRow.stored_bytes + more}
        if now is not None:
            values["active"] = now
        await session.execute(update(OwnerRow).where(OwnerRow.id == owner_id).values(**values))

    async def take(self, session: AsyncSession, owner_id: str, more: int, *, reserve: bool = False) -> None:
        """Count bytes that an owner is about to store. If they do not fit, its oldest practice is deleted for them.

        Args:
            session: The transaction.
            owner_id: Id of the owner.
            more: Bytes.
            reserve: They are what an evaluation can come to, which the error then says.

        Raises:
            QuotaReachedError: They do not fit even then.
        """
        await self.make_room(session, owner_id, more, reserve=reserve)
        await self.add(session, owner_id, more, now=time.time())

    async def make_room(self, session: AsyncSession, owner_id: str, more: int, *, reserve: bool = False) -> None:
        """Make room for so many bytes, if need be by deleting the owner's oldest practice. As :meth:`take` otherwise.

        Raises:
            QuotaReachedError: They do not fit even then.
        """
        reached = await self._reached(session, owner_id, more)
        if reached is not None:
            await self._evict(session, owner_id, reached.over)
            await self.check(session, owner_id, more, reserve=reserve)

    async def fits(self, session: AsyncSession, owner_id: str, more: int) -> bool:
        """Return whether an owner may store so many bytes more."""
        return await self._reached(session, owner_id, more) is None

    async def check(self, session: AsyncSession, owner_id: str, more: int, *, reserve: bool = False) -> None:
        """Check that an owner may store so many bytes more. Raises QuotaReachedError."""
        reached = await self._reached(session, owner_id, more)
        if reached is not None:
            raise QuotaReachedError(reached.sentence(reserve=reserve))

    async def _reached(self, session: AsyncSession, owner_id: str, more: int) -> _Reached | None:
        """Return the quota that so many bytes more would exceed, the one by most; None if they fit."""
        query = select(OwnerRow.name_key, OwnerRow.origin, OwnerRow.stored_bytes).where(OwnerRow.id == owner_id)
        found = (await session.execute(query)).first()
        if found is None or found.name_key == OWNER_NAME.lower():
            return None
        sums = [_Reached("this owner", "WRONGTURN_BYTES_PER_OWNER", found.stored_bytes, more, self._quota.owner_bytes)]
        if found.origin is not None:
            all_of_it = await self._of_address(session, found.origin)
            address = "the address that registered this owner"
            sums.append(_Reached(address, "WRONGTURN_BYTES_PER_ADDRESS", all_of_it, more, self._quota.address_bytes))
        worst = max(sums, key=lambda quota: quota.over)
        return worst if worst.over > 0 else None

    async def _of_address(self, session: AsyncSession, origin: str) -> int:
        total = select(func.coalesce(func.sum(OwnerRow.stored_bytes), 0)).where(OwnerRow.origin == origin)
        return int(await session.scalar(total) or 0)

    async def _evict(self, session: AsyncSession, owner_id: str, wanted: int) -> None:
        """Delete an owner's oldest practice until so many bytes are free, or none is left."""
        own = select(AgentRow.id).where(AgentRow.owner_id == owner_id)
        query = (
            select(EpisodeRow.id, EpisodeRow.stored_bytes)
            .where(EpisodeRow.agent_id.in_(own), *over_practice())
            .order_by(EpisodeRow.finished)
            .limit(_BATCH)
        )
        while wanted > 0:
            rows = (await session.execute(query)).tuples().all()
            if not rows:
                break
            some: list[str] = []
            for episode, size in rows:
                some.append(episode)
                wanted -= size
                if wanted <= 0:
                    break
            await self.delete_episodes(session, EpisodeRow.id.in_(some))

    async def remember(
        self, session: AsyncSession, reply: IdempotencyRow | None, owner_id: str, evaluation_id: str | None = None
    ) -> None:
        """Store the reply for an idempotency key, and count it.

        Args:
            session: The transaction.
            reply: The reply. None without a key.
            owner_id: The owner whose bytes it counts to.
            evaluation_id: The evaluation whose reserve has room for it. Without it the owner's quota must have room.

        Raises:
            QuotaReachedError: It does not fit.
        """
        if reply is None:
            return
        reply.owner_id, reply.stored_bytes = owner_id, size_of(reply.body, reply.sealed_token)
        if evaluation_id is None:
            await self.take(session, owner_id, reply.stored_bytes)
        else:
            reserve = update(EvaluationRow).where(EvaluationRow.id == evaluation_id)
            await session.execute(reserve.values(stored_bytes=EvaluationRow.stored_bytes - reply.stored_bytes))
        session.add(reply)

    async def check_accounts(self, session: AsyncSession, owner: OwnerRow, *, agents: int, owners: int) -> None:
        """Check that an owner may be stored, or have an agent more.

        Args:
            session: The transaction.
            owner: The owner.
            agents: Number of its new agents.
            owners: 1 if the owner is new, else 0.

        Raises:
            QuotaReachedError: It has, or its address has, as many as may be.
        """
        if owner.name_key == OWNER_NAME.lower():
            return
        has = await session.scalar(select(func.count()).where(AgentRow.owner_id == owner.id)) or 0
        if has + agents > self._quota.agents:
            raise QuotaReachedError(
                f"this owner has {has} agents, as many as it may have; go on with one of them, or ask the operator to "
                "raise WRONGTURN_AGENTS_PER_OWNER"
            )
        if owner.origin is None:
            return
        of_address = select(func.count()).where(OwnerRow.origin == owner.origin)
        theirs = select(func.count()).join_from(AgentRow, OwnerRow).where(OwnerRow.origin == owner.origin)
        total = (await session.scalar(of_address) or 0) + (await session.scalar(theirs) or 0)
        if total + agents + owners > self._quota.accounts:
            raise QuotaReachedError(
                f"{total} owners and agents have registered from this address, as many as may; go on with one of "
                "them, or ask the operator to raise WRONGTURN_ACCOUNTS_PER_ADDRESS"
            )

    # What has come to its end

    async def settle_evaluation(self, session: AsyncSession, evaluation_id: str, size: int) -> None:
        """Count an evaluation that is over at what it has come to: a row of this size, and its episodes."""
        evaluation = await session.get(EvaluationRow, evaluation_id, populate_existing=True)
        if evaluation is None:
            return
        episodes = select(func.coalesce(func.sum(EpisodeRow.stored_bytes), 0)).where(
            EpisodeRow.evaluation_id == evaluation_id
        )
        size += int(await session.scalar(episodes) or 0)
        owner = await owner_of(session, evaluation.agent_id)
        await self.add(session, owner, size - evaluation.stored_bytes)
        evaluation.stored_bytes = size

    async def settle_episode(self, session: AsyncSession, episode_id: str, trajectory: int = 0) -> None:
        """Count an episode that is over at what it has come to, with so many bytes of its trajectory."""
        episode = await session.get(EpisodeRow, episode_id, populate_existing=True)
        if episode is None:
            return
        size = size_of(episode.trial, episode.outcome, episode.last_reply) + trajectory
        if episode.evaluation_id is None:
            owner = await owner_of(session, episode.agent_id)
            await self.add(session, owner, size - episode.stored_bytes)
        episode.stored_bytes = size

    # Deletions

    async def delete_episodes(self, session: AsyncSession, *where: ColumnElement[bool]) -> None:
        """Delete episodes with their trajectories and stored replies. Scored ones are counted with their evaluation."""
        episodes = select(EpisodeRow.id).where(*where)
        await self.delete_replies(session, IdempotencyRow.episode_id.in_(episodes))
        sizes = select(AgentRow.owner_id, func.sum(EpisodeRow.stored_bytes)).join_from(EpisodeRow, AgentRow)
        practice = sizes.where(EpisodeRow.evaluation_id.is_(None), *where)
        await self._give_back(session, practice.group_by(AgentRow.owner_id))
        await session.execute(delete(TrajectoryRow).where(TrajectoryRow.episode_id.in_(episodes)))
        await session.execute(delete(EpisodeRow).where(*where))

    async def delete_replies(self, session: AsyncSession, *where: ColumnElement[bool]) -> None:
        """Delete replies that were stored for idempotency keys."""
        sizes = select(IdempotencyRow.owner_id, func.sum(IdempotencyRow.stored_bytes)).where(*where)
        await self._give_back(session, sizes.group_by(IdempotencyRow.owner_id))
        await session.execute(delete(IdempotencyRow).where(*where))

    async def _give_back(self, session: AsyncSession, sizes: "Select[Any, Any]") -> None:
        for owner, size in (await session.execute(sizes)).tuples().all():
            if owner is not None:
                await self.add(session, owner, -int(size))

    async def recount(self, session: AsyncSession, owner_id: str) -> int:
        """Count an owner's bytes anew from its rows, for example after many were deleted, and return them."""
        own = select(AgentRow.id).where(AgentRow.owner_id == owner_id)
        evaluations = select(EvaluationRow.id).where(EvaluationRow.agent_id.in_(own))
        owner = await session.get(OwnerRow, owner_id)
        total = 0 if owner is None else size_of(owner.contact)
        for size, belongs in (
            (AgentRow.stored_bytes, AgentRow.owner_id == owner_id),
            (EvaluationRow.stored_bytes, EvaluationRow.agent_id.in_(own)),
            # Scored episodes are counted with their evaluation.
            (EpisodeRow.stored_bytes, EpisodeRow.agent_id.in_(own) & EpisodeRow.evaluation_id.is_(None)),
            (ResultsRow.stored_bytes, ResultsRow.evaluation_id.in_(evaluations)),
            (IdempotencyRow.stored_bytes, IdempotencyRow.owner_id == owner_id),
            (SubmissionRow.stored_bytes, SubmissionRow.owner_id == owner_id),
        ):
            total += int(await session.scalar(select(func.coalesce(func.sum(size), 0)).where(belongs)) or 0)
        await session.execute(update(OwnerRow).where(OwnerRow.id == owner_id).values(stored_bytes=total))
        return total


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.3g} MB" if size < 1e9 else f"{size / 1e6:.0f} MB"


async def owner_of(session: AsyncSession, agent_id: str) -> str:
    """Return the id of an agent's owner."""
    return await session.scalar(select(AgentRow.owner_id).where(AgentRow.id == agent_id)) or ""


def reserve_of(trials: Iterable[Trial]) -> int:
    """Return the bytes that episodes of these trials can come to, with the stored replies to their resets."""
    return sum(REPLY_RESERVE + (EPISODE_RESERVE if trial.journey is None else JOURNEY_RESERVE) for trial in trials)


def over_practice() -> Sequence[ColumnElement[bool]]:
    """Return the conditions for practice that is over."""
    return EpisodeRow.evaluation_id.is_(None), EpisodeRow.state != EpisodeState.OPEN


def size_of(*values: str | bytes | None, more: int = ROW) -> int:
    """Return the bytes that a row with these texts takes.

    Args:
        *values: Its long columns.
        more: What it takes beside them.
    """
    return more + sum(len(value.encode() if isinstance(value, str) else value) for value in values if value is not None)
