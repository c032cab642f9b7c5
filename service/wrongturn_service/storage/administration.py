"""What the operator does: lists of everything, hiding, revoking, deletions in small steps, and the audit log of it."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from sqlalchemy import ColumnElement, and_, delete, false, func, or_, select, update
from sqlalchemy.ext.asyncio import AsyncSession

from wrongturn_protocol import SubmissionState
from wrongturn_protocol.administration import AuditKind, Contents
from wrongturn_protocol.vocabulary import AuditAction, Collection
from wrongturn_service.storage import held
from wrongturn_service.storage.accounts import end_tokens
from wrongturn_service.storage.models import (
    AgentRow,
    AuditRow,
    EvaluationRow,
    HeldRow,
    IdempotencyRow,
    OwnerRow,
    SigningKeyRow,
    SubmissionRow,
    TrajectoryRow,
    UnusedSecretRow,
)
from wrongturn_service.storage.queries import Queries, next_number
from wrongturn_service.storage.submissions import OPEN
from wrongturn_service.storage.usage import KINDS, stored

Item = OwnerRow | AgentRow | EvaluationRow | SubmissionRow
ROWS: Final[dict[Collection, type[Item]]] = {
    Collection.OWNERS: OwnerRow,
    Collection.AGENTS: AgentRow,
    Collection.EVALUATIONS: EvaluationRow,
    Collection.SUBMISSIONS: SubmissionRow,
}

_BATCH: Final = 100
_LONGEST_NAME: Final = 160


class After(NamedTuple):
    """Where a page begins: after the item that was made at this time and has this id."""

    created: float
    id: str


@dataclass(frozen=True)
class Filters:
    """What a list is narrowed to, by ids. None leaves a filter out."""

    name: str | None = None
    """Part of the name of the owner or the agent, in upper or lower case."""
    owner: str | None = None
    agent: str | None = None
    suite: str | None = None
    state: str | None = None
    hidden: bool | None = None


class Found(NamedTuple):
    """A row with the name of its agent, or its own."""

    row: Item
    name: str
    owner: str | None


@dataclass(frozen=True)
class Deleted:
    """What was deleted: its name, and the ids of what went with it."""

    name: str
    held: tuple[str, ...]
    """What stays taken, in words."""
    agents: Sequence[str]
    evaluations: Sequence[str]
    submissions: Sequence[str]
    cancelled: Sequence[str]
    """Ids of submissions that waited or ran, also of those that stay."""


@dataclass(frozen=True)
class Act:
    """Who does something, from where, and why. It is written down in the transaction that does it."""

    actor: str
    """``operator``, and the first digits of the SHA-256 of the token that was sent."""
    address: str
    reason: str | None = None

    async def note(
        self, session: AsyncSession, action: AuditAction, target: tuple[AuditKind, str, str], contents: Contents
    ) -> None:
        """Add an entry about a target, by its kind, its id and its name, as the last one."""
        collection, item_id, name = target
        entry = AuditRow(
            seq=await next_number(session, AuditRow.seq),
            time=time.time(),
            actor=self.actor,
            address=self.address[:64],
            action=action.value,
            kind=str(collection),
            target=item_id,
            name=name[:_LONGEST_NAME],
            reason=self.reason,
            counts=contents.model_dump_json(exclude_defaults=True),
        )
        session.add(entry)


class AdministrationStore(Queries):
    """Reads and deletes for the operator. Each method is one transaction."""

    async def keys(self) -> Sequence[SigningKeyRow]:
        """Return the keys of certificates, newest first."""
        return await self._all(select(SigningKeyRow).order_by(SigningKeyRow.seq.desc()))

    async def add_key(self, public: str, private: bytes | None, act: Act | None) -> None:
        """Let a new key sign, and forget the private part of the one before. Raises ValueError for a retired key."""
        async with self._database.write() as session:
            if await session.scalar(select(SigningKeyRow).where(SigningKeyRow.public == public)) is not None:
                raise ValueError("the key was retired; make a new one")
            before = update(SigningKeyRow).where(SigningKeyRow.retired.is_(None))
            await session.execute(before.values(retired=time.time(), private=None))
            seq = await next_number(session, SigningKeyRow.seq)
            session.add(SigningKeyRow(seq=seq, public=public, private=private, created=time.time()))
            if act is not None:
                await act.note(session, AuditAction.ROTATE, ("keys", f"key {seq}", public), Contents())

    async def page(self, collection: Collection, filters: Filters, after: After | None, limit: int) -> Sequence[Found]:
        """Return some items, newest first.

        ``after`` is where the page begins.
        """
        row = ROWS[collection]
        query = _found(collection).where(*_conditions(collection, filters))
        if after is not None:
            earlier = and_(row.created == after.created, row.id < after.id)
            query = query.where(or_(row.created < after.created, earlier))
        found = await self._rows(query.order_by(row.created.desc(), row.id.desc()).limit(limit))
        return [Found(*one) for one in found]

    async def item(self, collection: Collection, item_id: str) -> Found | None:
        """Return an item, or None."""
        found = await self._rows(_found(collection).where(ROWS[collection].id == item_id))
        return Found(*found[0]) if found else None

    async def id_of(self, collection: Collection, word: str) -> str | None:
        """Return the id of the owner or agent that has this id, or else this name in upper or lower case; or None."""
        row: Any = ROWS[collection]
        found = await self._all(select(row.id).where(or_(row.id == word, row.name_key == word.lower())))
        return max(found, key=lambda one: one == word, default=None)

    async def contents(self, collection: Collection, item_id: str) -> Contents:
        """Return what hangs on an item, with the item itself."""
        async with self._database.read() as session:
            return await _contents(session, *await _whole(session, collection, item_id))

    async def hide(self, collection: Collection, item_id: str, act: Act, *, hidden: bool) -> int:
        """Hide an item, or show it again. Return 0 if nothing has changed."""
        row = ROWS[collection]
        async with self._database.write() as session:
            there = select(row).where(row.id == item_id, getattr(row, "hidden") != hidden)  # noqa: B009
            found: Any = await session.scalar(there)
            if found is not None:
                found.hidden = hidden
                action = AuditAction.HIDE if hidden else AuditAction.UNHIDE
                target = collection, item_id, await _name(session, collection, item_id)
                await act.note(session, action, target, Contents(**{collection.value: 1}))
        return int(found is not None)

    async def revoke(self, collection: Collection, item_id: str, act: Act) -> tuple[int, Sequence[str]]:
        """End the token of an agent, or those of an owner and its agents.

        Returns the number of tokens that ended, and the ids of the agents among their holders.
        """
        async with self._database.write() as session:
            has_token = _ids("agents", collection, item_id).where(AgentRow.token_sha256.is_not(None))
            agents = (await session.scalars(has_token)).all()
            query = select(OwnerRow.id).where(OwnerRow.id == item_id, OwnerRow.token_sha256.is_not(None))
            owners = (await session.scalars(query)).all()
            await end_tokens(session, owners=owners, agents=agents)
            if owners or agents:
                target = collection, item_id, await _name(session, collection, item_id)
                await act.note(session, AuditAction.REVOKE, target, Contents(owners=len(owners), agents=len(agents)))
        return len(owners) + len(agents), agents

    async def delete_trajectories(self, collection: Collection, item_id: str) -> bool:
        """Delete some trajectories of an item that is about to be deleted. Return whether there may be more.

        They are most of its bytes. In small steps, others can write in between.
        """
        async with self._database.write() as session:
            some = _ids("trajectories", *await _whole(session, collection, item_id)).limit(_BATCH)
            episodes = (await session.scalars(some)).all()
            await session.execute(delete(TrajectoryRow).where(TrajectoryRow.episode_id.in_(episodes)))
            return len(episodes) == _BATCH

    async def delete(
        self, collection: Collection, item_id: str, contents: Contents, act: Act, *, free: bool
    ) -> Deleted | None:
        """Delete an item with all that hangs on it, and cancel the submissions that drove it. None if it is gone.

        ``contents`` are for the audit log. What stays taken, unless it is freed, is noted under the id of the item.
        """
        async with self._database.write() as session:
            if await session.get(ROWS[collection], item_id) is None:
                return None
            name = await _name(session, collection, item_id)
            whole = await _whole(session, collection, item_id)
            agents, evaluations, submissions = [
                (await session.scalars(_ids(kind, *whole))).all() for kind in ("agents", "evaluations", "submissions")
            ]
            its = or_(SubmissionRow.id.in_(submissions), SubmissionRow.evaluation_id.in_(evaluations))
            waiting = select(SubmissionRow.id).where(its, SubmissionRow.state.in_(OPEN))
            cancelled = (await session.scalars(waiting)).all()
            over = {"state": SubmissionState.CANCELLED, "ended": time.time(), "reason": "deleted by the operator"}
            await session.execute(
                update(SubmissionRow).where(SubmissionRow.id.in_(cancelled)).values(**over, token_sha256=None)
            )
            if not free:
                await _hold(session, *whole, item_id)
            kind, target = whole
            # What the database does not delete with the row.
            with_it = {
                Collection.AGENTS: delete(SubmissionRow).where(SubmissionRow.agent_id == target),
                Collection.EVALUATIONS: delete(IdempotencyRow).where(IdempotencyRow.evaluation_id == target),
                Collection.SUBMISSIONS: delete(IdempotencyRow).where(IdempotencyRow.scope == target),
            }
            if kind in with_it:
                await session.execute(with_it[kind])
            await session.execute(delete(ROWS[kind]).where(ROWS[kind].id == target))
            await act.note(session, AuditAction.DELETE, (collection, item_id, name), contents)
            taken = await held.held_by(session, item_id)
        return Deleted(name, taken, agents, evaluations, submissions, cancelled)

    async def deleted_before(
        self, collection: Collection, item_id: str, act: Act, *, free: bool
    ) -> tuple[str, tuple[str, ...]] | None:
        """Return the name of an item that was deleted earlier, and what stays taken; None if it never was there.

        ``free`` frees now what the deletion kept taken.
        """
        async with self._database.write() as session:
            known = select(AuditRow).where(
                AuditRow.target == item_id, AuditRow.kind == collection, AuditRow.action == AuditAction.DELETE
            )
            entry = await session.scalar(known.order_by(AuditRow.seq.desc()).limit(1))
            if entry is None:
                return None
            if free and await held.free(session, item_id):
                await act.note(session, AuditAction.FREE, (collection, item_id, entry.name), Contents())
            return entry.name, await held.held_by(session, item_id)

    async def usage(self, begin: int, limit: int) -> tuple[list[tuple[str, str, Contents]], Contents]:
        """Return some owners with what they have stored, those with the most bytes first, and the sum over all owners.

        The page leaves out the owners before ``begin``.
        """
        size = stored().label("size")
        page = select(OwnerRow.id, OwnerRow.name, size).order_by(size.desc(), OwnerRow.id).offset(begin).limit(limit)
        everything: dict[str, int] = {}
        async with self._database.read() as session:
            rows = (await session.execute(page)).tuples().all()
            found: dict[str, dict[str, int]] = {owner: {"bytes": size} for owner, _, size in rows}
            for name, kind in KINDS.items():
                owner_id = kind.of[Collection.OWNERS]
                query = select(kind.number, kind.bytes).select_from(kind.rows)
                everything[name], size_of_all = (await session.execute(query)).one()
                everything["bytes"] = everything.get("bytes", 0) + int(size_of_all)
                of_page = select(owner_id, kind.number).select_from(kind.rows).where(owner_id.in_(found))
                for owner, number in (await session.execute(of_page.group_by(owner_id))).tuples():
                    found[owner][name] = number
        return [(owner, name, Contents(**found[owner])) for owner, name, _ in rows], Contents(**everything)

    async def note(self, act: Act, action: AuditAction, collection: Collection, row: Item, name: str) -> None:
        """Add an entry to the audit log about something that was done already."""
        async with self._database.write() as session:
            await act.note(session, action, (collection, row.id, name), Contents(**{collection.value: 1}))

    async def entries(
        self,
        *,
        before: int | None,
        limit: int,
        target: str | None = None,
        named: tuple[Collection, str] | None = None,
        action: AuditAction | None = None,
    ) -> Sequence[AuditRow]:
        """Return entries of the audit log, newest first.

        ``before`` is a number, ``target`` an id, and ``named`` the kind of a target and a name that it has, or had, in
        upper or lower case.
        """
        query = select(AuditRow).order_by(AuditRow.seq.desc()).limit(limit)
        if before is not None:
            query = query.where(AuditRow.seq < before)
        if target is not None:
            query = query.where(AuditRow.target == target)
        if named is not None:
            collection, name = named
            query = query.where(AuditRow.kind == collection, func.lower(AuditRow.name) == name.lower())
        if action is not None:
            query = query.where(AuditRow.action == action)
        return await self._all(query)


def _ids(name: str, collection: Collection, item_id: str) -> Any:
    """Return the query for the ids of the rows of a kind that hang on an item."""
    kind = KINDS[name]
    query = kind.select(kind.id, of=collection, item=item_id)
    return select(kind.id).where(false()) if query is None else query


async def _contents(session: AsyncSession, collection: Collection, item_id: str) -> Contents:
    found: dict[str, int] = {}
    for name, kind in KINDS.items():
        query = kind.select(kind.number, kind.bytes, of=collection, item=item_id)
        if query is not None:
            found[name], size = (await session.execute(query)).one()
            found["bytes"] = found.get("bytes", 0) + int(size)
    return Contents(**found)


async def _whole(session: AsyncSession, collection: Collection, item_id: str) -> tuple[Collection, str]:
    """Return what is deleted with an item: the owner that was made with an agent, which has its name and nothing else.

    Any other item is itself.
    """
    agent = await session.get(AgentRow, item_id) if collection is Collection.AGENTS else None
    if agent is None or agent.owner.token_sha256 is not None or agent.owner.name_key != agent.name_key:
        return collection, item_id
    other_agents = select(AgentRow.id).where(AgentRow.owner_id == agent.owner_id, AgentRow.id != item_id)
    other_submissions = select(SubmissionRow.id).where(
        SubmissionRow.owner_id == agent.owner_id, SubmissionRow.agent_id.is_distinct_from(item_id)
    )
    for others in (other_agents, other_submissions):
        if await session.scalar(others.limit(1)) is not None:
            return collection, item_id
    return Collection.OWNERS, agent.owner_id


async def _hold(session: AsyncSession, collection: Collection, item_id: str, deleted: str) -> None:
    """Keep the names, and the place on a suite, of what is about to be deleted."""
    for row, kind in ((OwnerRow, Collection.OWNERS), (AgentRow, Collection.AGENTS)):
        names = select(row.name_key).where(row.id.in_(_ids(kind, collection, item_id)))
        for key in (await session.scalars(names)).all():
            await session.merge(HeldRow(kind=kind.one, key=key, deleted=deleted))
    evaluation = await session.get(EvaluationRow, item_id) if collection is Collection.EVALUATIONS else None
    if evaluation is None:
        return
    agent, suite = evaluation.agent_id, evaluation.suite
    if evaluation.driven is None:
        # It never counted. The agent's next one gets its trials.
        await session.merge(UnusedSecretRow(agent_id=agent, suite=suite, secret=evaluation.secret))
        return
    of_agent = EvaluationRow.agent_id == agent, EvaluationRow.suite == suite, EvaluationRow.driven.is_not(None)
    first = select(EvaluationRow.id).where(*of_agent).order_by(EvaluationRow.seq).limit(1)
    if await session.scalar(first) == item_id:
        key = held.place(agent, suite)
        await session.merge(HeldRow(kind=collection.one, key=key, agent_id=agent, deleted=deleted))


def _found(collection: Collection) -> Any:
    if collection is Collection.EVALUATIONS:
        agent = AgentRow.id == EvaluationRow.agent_id
        return select(EvaluationRow, AgentRow.name, AgentRow.owner_id).join(AgentRow, agent)
    row: Any = ROWS[collection]
    return select(row, row.name, row.id if row is OwnerRow else row.owner_id)


def _conditions(collection: Collection, filters: Filters) -> list[ColumnElement[bool]]:
    row: Any = ROWS[collection]
    agent = AgentRow if collection is Collection.EVALUATIONS else row
    found: list[ColumnElement[bool]] = []
    if filters.name is not None:
        found.append(agent.name_key.contains(filters.name.lower(), autoescape=True))
    if filters.owner is not None:
        found.append(agent.owner_id == filters.owner)
    if filters.agent is not None:
        found.append(row.agent_id == filters.agent)
    found += [
        getattr(row, column) == value
        for column, value in (("suite", filters.suite), ("state", filters.state), ("hidden", filters.hidden))
        if value is not None
    ]
    return found


async def _name(session: AsyncSession, collection: Collection, item_id: str) -> str:
    found = (await session.execute(_found(collection).where(ROWS[collection].id == item_id))).first()
    return "" if found is None else str(found[1])
