"""Queries about owners and agents."""

from collections.abc import Sequence

from sqlalchemy import and_, delete, inspect, or_, select, update
from sqlalchemy.ext.asyncio import AsyncSession

from wrongturn_protocol.vocabulary import Collection
from wrongturn_service.storage import held
from wrongturn_service.storage.models import AgentRow, IdempotencyRow, OwnerRow
from wrongturn_service.storage.queries import Queries
from wrongturn_service.storage.usage import owner_of, size_of
from wrongturn_service.storage.visible import has_evaluation, seen_agents, seen_owners


class AgentNameTakenError(Exception):
    """Another agent has this name."""


class OwnerNameTakenError(Exception):
    """Another owner has this name."""


class HolderGoneError(Exception):
    """The owner or the agent that calls was deleted while its call was in progress."""


class AccountStore(Queries):
    """Reads and writes owners and agents."""

    async def add_owner(self, owner: OwnerRow, reply: IdempotencyRow | None) -> None:
        """Store a new owner. Raises OwnerNameTakenError, QuotaReachedError."""
        async with self._database.write() as session:
            await _check_owner_name(session, owner)
            await self._usage.check_accounts(session, owner, agents=0, owners=1)
            await self._add_owner(session, owner)
            await self._usage.remember(session, reply, owner.id)

    async def _add_owner(self, session: AsyncSession, owner: OwnerRow) -> None:
        owner.stored_bytes, owner.active = size_of(owner.contact), owner.created
        session.add(owner)
        await session.flush()
        await self._usage.make_room(session, owner.id, 0)

    async def reserve_owner(self, owner: OwnerRow) -> None:
        """Store a new owner, unless one of its name is there already."""
        async with self._database.write() as session:
            there = select(OwnerRow.id).where(OwnerRow.name_key == owner.name_key)
            if await session.scalar(there) is None:
                session.add(owner)

    async def owners(self, *, after: str | None = None, limit: int | None = None) -> Sequence[OwnerRow]:
        """Return owners by name, without hidden ones.

        ``after`` is a name in lower case.
        """
        query = select(OwnerRow).where(seen_owners()).order_by(OwnerRow.name_key).limit(limit)
        if after is not None:
            query = query.where(OwnerRow.name_key > after)
        return await self._all(query)

    async def owner(self, owner_id: str) -> OwnerRow | None:
        """Return an owner, or None."""
        return await self._get(OwnerRow, owner_id)

    async def owner_by_name(self, name_key: str) -> OwnerRow | None:
        """Return the owner with a name in lower case, or None."""
        return await self._one(select(OwnerRow).where(OwnerRow.name_key == name_key))

    async def owner_by_token(self, token_sha256: str) -> OwnerRow | None:
        """Return the owner with this token, or None."""
        return await self._one(select(OwnerRow).where(OwnerRow.token_sha256 == token_sha256))

    async def add_agent(self, agent: AgentRow, reply: IdempotencyRow | None) -> None:
        """Store a new agent, and its owner if that is new.

        Raises:
            AgentNameTakenError, OwnerNameTakenError.
            QuotaReachedError: The owner or its address has too many agents or bytes.
        """
        owner = agent.owner
        async with self._database.write() as session:
            if await agent_name_taken(session, agent.name_key):
                raise AgentNameTakenError(agent.name)
            new = inspect(owner).transient
            if new:
                await _check_owner_name(session, owner)
            else:
                await check_there(session, OwnerRow, owner.id)
            await self._usage.check_accounts(session, owner, agents=1, owners=int(new))
            if new:
                await self._add_owner(session, owner)
            agent.stored_bytes = size_of(agent.description, agent.homepage)
            await self._usage.take(session, owner.id, agent.stored_bytes)
            session.add(agent)
            await self._usage.remember(session, reply, owner.id, {"agent_id": agent.id})

    async def agents(
        self, *, evaluated: bool = False, after: str | None = None, limit: int | None = None
    ) -> Sequence[AgentRow]:
        """Return agents by name, without hidden ones.

        ``evaluated`` leaves out those without an evaluation, which at most have practised. ``after`` is a name in lower
        case.
        """
        query = select(AgentRow).where(seen_agents()).order_by(AgentRow.name_key).limit(limit)
        if evaluated:
            query = query.where(has_evaluation())
        if after is not None:
            query = query.where(AgentRow.name_key > after)
        return await self._all(query)

    async def agent(self, agent_id: str) -> AgentRow | None:
        """Return an agent, or None."""
        return await self._get(AgentRow, agent_id)

    async def agent_called(self, wanted: str) -> AgentRow | None:
        """Return the agent that has this id, or else this name in upper or lower case; None without either.

        Hidden ones are left out.
        """
        if "\0" in wanted:  # which PostgreSQL refuses
            return None
        async with self._database.read() as session:
            called = or_(AgentRow.id == wanted, AgentRow.name_key == wanted.lower())
            query = select(AgentRow).where(called, seen_agents())
            found = (await session.scalars(query)).all()
        # A name may look like another agent's id.
        return max(found, key=lambda agent: agent.id == wanted, default=None)

    async def agent_by_token(self, token_sha256: str) -> AgentRow | None:
        """Return the agent with this token, or None."""
        return await self._one(select(AgentRow).where(AgentRow.token_sha256 == token_sha256))

    async def set_token(
        self, holder: OwnerRow | AgentRow, token_sha256: str | None, reply: IdempotencyRow | None = None
    ) -> None:
        """Replace the token of an owner or an agent. None revokes it."""
        row, agent = type(holder), isinstance(holder, AgentRow)
        async with self._database.write() as session:
            await end_tokens(session, **{"agents" if agent else "owners": [holder.id]})
            await session.execute(update(row).where(row.id == holder.id).values(token_sha256=token_sha256))
            owner = await owner_of(session, holder.id) if agent else holder.id
            await self._usage.remember(session, reply, owner, {"agent_id": holder.id if agent else None})

    async def renew_token(self, reply: IdempotencyRow, token_sha256: str) -> None:
        """Replace the token that a stored reply had, unless it was rotated or revoked since."""
        row, holder = (OwnerRow, reply.owner_id) if reply.agent_id is None else (AgentRow, reply.agent_id)
        async with self._database.write() as session:
            if await session.get(IdempotencyRow, (reply.scope, reply.key_sha256)) is not None:
                await session.execute(update(row).where(row.id == holder).values(token_sha256=token_sha256))


async def end_tokens(session: AsyncSession, *, owners: Sequence[str] = (), agents: Sequence[str] = ()) -> None:
    """End the tokens of owners and agents. Afterwards a repeated registration or rotation makes no new one."""
    of_owners = and_(IdempotencyRow.owner_id.in_(owners), IdempotencyRow.agent_id.is_(None))
    theirs = or_(of_owners, IdempotencyRow.agent_id.in_(agents))
    await session.execute(delete(IdempotencyRow).where(IdempotencyRow.with_token, theirs))
    for row, holders in ((OwnerRow, owners), (AgentRow, agents)):
        await session.execute(update(row).where(row.id.in_(holders)).values(token_sha256=None))


async def _check_owner_name(session: AsyncSession, owner: OwnerRow) -> None:
    taken = select(OwnerRow.id).where(OwnerRow.name_key == owner.name_key)
    if await session.scalar(taken) is not None or await held.is_held(session, Collection.OWNERS, owner.name_key):
        raise OwnerNameTakenError(owner.name)


async def agent_name_taken(session: AsyncSession, name_key: str) -> bool:
    """Return whether an agent has a name in lower case, or the operator has deleted one that had it."""
    taken = select(AgentRow.id).where(AgentRow.name_key == name_key)
    return await session.scalar(taken) is not None or await held.is_held(session, Collection.AGENTS, name_key)


async def check_there(session: AsyncSession, row: type[OwnerRow | AgentRow], holder_id: str) -> None:
    """Check that the caller was not deleted since its token was looked up. Raises HolderGoneError."""
    if await session.scalar(select(row.id).where(row.id == holder_id)) is None:
        raise HolderGoneError(holder_id)
