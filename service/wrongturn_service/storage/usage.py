"""What is stored for owners, by kind, and how much each owner and address may have.

Each row that belongs to an owner has its size in the column ``stored_bytes``. What is still growing has the size that
it may come to: an episode of practice until it ends, an evaluation until it is finished. :func:`stored` sums them.

A sum over many rows takes too long for each reset. So an owner's own ``stored_bytes`` only grows as things are stored,
and is summed anew when it reaches the quota.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from sqlalchemy import ColumnElement, case, delete, func, or_, select, update
from sqlalchemy.ext.asyncio import AsyncSession
from sqlalchemy.orm import aliased, join, outerjoin

from wrongturn_protocol import EpisodeState, EvaluationState, Rig
from wrongturn_protocol.reserved_names import OWNER_NAME
from wrongturn_protocol.vocabulary import Collection
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
class Kind:
    """A kind of rows."""

    rows: Any
    """The table, joined to those that say whose a row is."""
    id: Any
    of: dict[Collection, Any]
    """Columns that name the owner, agent, evaluation or submission with which a row is deleted."""
    size: Any = None
    """Bytes of a row. None if they are counted with another kind."""
    number: Any = field(default_factory=func.count)

    @property
    def bytes(self) -> Any:
        """The sum of the rows' bytes."""
        return func.coalesce(func.sum(0 if self.size is None else self.size), 0)

    def select(self, *columns: Any, of: Collection, item: Any) -> Any:
        """Return the query for columns of the rows that belong to an item; None if no row of this kind does."""
        return select(*columns).select_from(self.rows).where(self.of[of] == item) if of in self.of else None


_OF_AGENT: Final = {Collection.OWNERS: AgentRow.owner_id, Collection.AGENTS: AgentRow.id}
_OF_EVALUATION: Final = {**_OF_AGENT, Collection.EVALUATIONS: EvaluationRow.id}
_OF_EPISODE: Final = {**_OF_AGENT, Collection.EVALUATIONS: EpisodeRow.evaluation_id}
_OF_SUBMISSION: Final = {
    Collection.OWNERS: SubmissionRow.owner_id,
    Collection.AGENTS: SubmissionRow.agent_id,
    Collection.SUBMISSIONS: SubmissionRow.id,
}
_OF_REPLY: Final = {
    Collection.OWNERS: IdempotencyRow.owner_id,
    Collection.AGENTS: IdempotencyRow.agent_id,
    Collection.EVALUATIONS: IdempotencyRow.evaluation_id,
    Collection.SUBMISSIONS: IdempotencyRow.submission_id,
}
_SCORED: Final = aliased(EvaluationRow)
_EVALUATIONS: Final = join(EvaluationRow, AgentRow, EvaluationRow.agent_id == AgentRow.id)
_EPISODES: Final = join(EpisodeRow, AgentRow, EpisodeRow.agent_id == AgentRow.id)
_HAS_MODEL: Final = SubmissionRow.stored_bytes > SUBMISSION
# An evaluation that runs has reserved the bytes of its episodes and of the replies to their resets.
_RESERVED: Final = _SCORED.state == EvaluationState.RUNNING
_SIZE_OF_EPISODE: Final = case((_RESERVED, 0), else_=EpisodeRow.stored_bytes)
_SIZE_OF_REPLY: Final = case((_RESERVED, 0), else_=IdempotencyRow.stored_bytes)
_SIZE_OF_OWNER: Final = ROW + func.coalesce(func.length(OwnerRow.contact), 0)
KINDS: Final = {
    "owners": Kind(OwnerRow, OwnerRow.id, {Collection.OWNERS: OwnerRow.id}, _SIZE_OF_OWNER),
    "agents": Kind(AgentRow, AgentRow.id, _OF_AGENT, AgentRow.stored_bytes),
    "evaluations": Kind(_EVALUATIONS, EvaluationRow.id, _OF_EVALUATION, EvaluationRow.stored_bytes),
    "episodes": Kind(
        outerjoin(_EPISODES, _SCORED, _SCORED.id == EpisodeRow.evaluation_id),
        EpisodeRow.id,
        _OF_EPISODE,
        _SIZE_OF_EPISODE,
    ),
    "trajectories": Kind(
        join(_EPISODES, TrajectoryRow, TrajectoryRow.episode_id == EpisodeRow.id), EpisodeRow.id, _OF_EPISODE
    ),
    "results": Kind(
        join(_EVALUATIONS, ResultsRow, ResultsRow.evaluation_id == EvaluationRow.id),
        ResultsRow.evaluation_id,
        _OF_EVALUATION,
        ResultsRow.stored_bytes,
    ),
    "submissions": Kind(SubmissionRow, SubmissionRow.id, _OF_SUBMISSION, SubmissionRow.stored_bytes),
    "models": Kind(SubmissionRow, SubmissionRow.id, _OF_SUBMISSION, number=func.count(case((_HAS_MODEL, 1)))),
    "replies": Kind(
        outerjoin(IdempotencyRow, _SCORED, _SCORED.id == IdempotencyRow.evaluation_id),
        IdempotencyRow.key_sha256,
        _OF_REPLY,
        _SIZE_OF_REPLY,
    ),
}
"""What is stored for owners, by the names of :class:`~wrongturn_protocol.administration.Contents`."""


def stored() -> Any:
    """Return the bytes that are stored for an owner, as a column beside those of :class:`OwnerRow`."""
    total: Any = _SIZE_OF_OWNER
    for name, kind in KINDS.items():
        if kind.size is not None and name != "owners":
            sizes = kind.select(kind.bytes, of=Collection.OWNERS, item=OwnerRow.id)
            total = total + sizes.correlate(OwnerRow).scalar_subquery()
    return total


@dataclass(frozen=True)
class Quota:
    """What an owner and an address may have."""

    owner_bytes: int = _UNLIMITED
    """Stored bytes of one owner."""
    address_bytes: int = _UNLIMITED
    """Stored bytes of all owners that registered from one address."""
    agents: int = _UNLIMITED
    """Agents of one owner."""
    accounts: int = _UNLIMITED
    """Owners and agents that registered from one address."""


class _Reached(NamedTuple):
    """A quota of bytes, and by how much it would be exceeded."""

    over: int
    whose: str
    setting: str
    stored: int
    most: int


class Usage:
    """Holds owners and addresses to their quota. Each method works in the caller's transaction."""

    def __init__(self, quota: Quota | None = None) -> None:
        self._quota = quota or Quota()

    async def add(self, session: AsyncSession, owner_id: str, more: int) -> None:
        """Count bytes that an owner stores, without a check."""
        values = {"stored_bytes": OwnerRow.stored_bytes + more, "active": time.time()}
        await session.execute(update(OwnerRow).where(OwnerRow.id == owner_id).values(**values))

    async def take(self, session: AsyncSession, owner_id: str, more: int, *, reserve: bool = False) -> None:
        """Count bytes that an owner is about to store, once there is room for them, see :meth:`make_room`."""
        await self.make_room(session, owner_id, more, reserve=reserve)
        await self.add(session, owner_id, more)

    async def make_room(self, session: AsyncSession, owner_id: str, more: int, *, reserve: bool = False) -> None:
        """Make room for so many bytes, if need be by deleting the owner's oldest practice.

        ``reserve`` says that they are what an evaluation can come to, which the error then explains. Raises
        QuotaReachedError if they do not fit even then.
        """
        summed = False
        while (reached := await self._reached(session, owner_id, more)) is not None:
            if summed and not await self._evict(session, owner_id, reached.over):
                raise QuotaReachedError(_sentence(reached, more, reserve=reserve))
            await self._sum(session, owner_id)
            summed = True

    async def _reached(self, session: AsyncSession, owner_id: str, more: int) -> _Reached | None:
        """Return the quota that so many bytes more would exceed, the one by most; None if they fit."""
        query = select(OwnerRow.name_key, OwnerRow.origin, OwnerRow.stored_bytes).where(OwnerRow.id == owner_id)
        found = (await session.execute(query)).first()
        if found is None or found.name_key == OWNER_NAME.lower():
            return None
        size, most = found.stored_bytes, self._quota.owner_bytes
        worst = _Reached(size + more - most, "this owner", "WRONGTURN_BYTES_PER_OWNER", size, most)
        if found.origin is not None:
            total = select(func.sum(OwnerRow.stored_bytes)).where(OwnerRow.origin == found.origin)
            size, most = int(await session.scalar(total) or 0), self._quota.address_bytes
            whose = "the address that registered this owner"
            worst = max(worst, _Reached(size + more - most, whose, "WRONGTURN_BYTES_PER_ADDRESS", size, most))
        return worst if worst.over > 0 else None

    async def _sum(self, session: AsyncSession, owner_id: str) -> None:
        """Sum what is stored for an owner and for the others of its address."""
        other = aliased(OwnerRow)
        origin = select(other.origin).where(other.id == owner_id).scalar_subquery()
        counted = update(OwnerRow).where(or_(OwnerRow.id == owner_id, OwnerRow.origin == origin))
        await session.execute(counted.values(stored_bytes=stored()).execution_options(synchronize_session=False))

    async def _evict(self, session: AsyncSession, owner_id: str, wanted: int) -> bool:
        """Delete so many bytes of an owner's oldest practice, or a part of them. Return whether there was any."""
        own = select(AgentRow.id).where(AgentRow.owner_id == owner_id)
        query = select(EpisodeRow.id, EpisodeRow.stored_bytes).where(EpisodeRow.agent_id.in_(own), *over_practice())
        some: list[str] = []
        for episode, size in (await session.execute(query.order_by(EpisodeRow.finished).limit(_BATCH))).tuples():
            if wanted <= 0:
                break
            some.append(episode)
            wanted -= size
        await session.execute(delete(EpisodeRow).where(EpisodeRow.id.in_(some)))
        return bool(some)

    async def remember(
        self,
        session: AsyncSession,
        reply: IdempotencyRow | None,
        owner_id: str,
        about: Mapping[str, str | None] | None = None,
        *,
        reserved: bool = False,
    ) -> None:
        """Store the reply for an idempotency key, if there is one. What it is about is stored already.

        Its bytes count to the owner; unless its evaluation has ``reserved`` them, they have to fit into the quota, or
        it raises QuotaReachedError. ``about`` are ids of what it is about: ``agent_id``, ``evaluation_id``,
        ``episode_id``, ``submission_id``.
        """
        if reply is None:
            return
        await session.flush()
        for name, value in {"owner_id": owner_id, **(about or {})}.items():
            setattr(reply, name, value)
        reply.stored_bytes = size_of(reply.body)
        if not reserved:
            await self.take(session, owner_id, reply.stored_bytes)
        session.add(reply)

    async def check_accounts(self, session: AsyncSession, owner: OwnerRow, *, agents: int, owners: int) -> None:
        """Check that an owner may have so many new agents; ``owners`` is 1 if it is new itself, else 0.

        Raises QuotaReachedError if it has, or its address has, as many as may be.
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


def _sentence(reached: _Reached, more: int, *, reserve: bool) -> str:
    """Return what is said to who wanted so many bytes more, which may be the reserve of an evaluation."""
    wanted = f"{_megabytes(more)} more do not fit" if more else "nothing more fits"
    if reserve:
        wanted = (
            f"an evaluation reserves {_megabytes(more)}, which do not fit now (at its end it keeps only what it "
            "stored, and the rest comes back)"
        )
    return (
        f"{wanted}: {reached.whose} has {_megabytes(reached.stored)} of {_megabytes(reached.most)}, its quota; finish "
        "or cancel running evaluations, wait until practice, models and stored replies are deleted with time, or ask "
        f"the operator to raise {reached.setting}"
    )


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.3g} MB" if size < 1e9 else f"{size / 1e6:.0f} MB"


async def owner_of(session: AsyncSession, agent_id: str) -> str:
    """Return the id of an agent's owner."""
    return await session.scalar(select(AgentRow.owner_id).where(AgentRow.id == agent_id)) or ""


def reserve_of(episodes: int, rig: Rig | None, *, journeys: bool) -> int:
    """Return the bytes that so many episodes can come to, with the stored replies to their resets and last steps."""
    pictures = 0 if rig is None else 2 * rig.picture_bytes
    return episodes * (REPLY_RESERVE + pictures + (JOURNEY_RESERVE if journeys else EPISODE_RESERVE))


def over_practice() -> Sequence[ColumnElement[bool]]:
    """Return the conditions for practice that is over."""
    return EpisodeRow.evaluation_id.is_(None), EpisodeRow.state != EpisodeState.OPEN


def size_of(*texts: str | bytes | None) -> int:
    """Return the bytes that a row with these texts takes."""
    return ROW + sum(len(text.encode() if isinstance(text, str) else text) for text in texts if text is not None)
