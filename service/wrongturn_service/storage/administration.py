"""Queries of the operator: lists of everything, and deletions in small steps."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from sqlalchemy import ColumnElement, and_, or_, select, update
from sqlalchemy.ext.asyncio import AsyncSession

from wrongturn_protocol.administration import Contents
from wrongturn_protocol.vocabulary import AuditAction, Collection
from wrongturn_service.storage import audit, contents, deletion, held
from wrongturn_service.storage.audit import Act
from wrongturn_service.storage.contents import Scope, counted, scope_of
from wrongturn_service.storage.database import Database
from wrongturn_service.storage.models import (
    AgentRow,
    AuditRow,
    EpisodeRow,
    EvaluationRow,
    OwnerRow,
    SubmissionRow,
)
from wrongturn_service.storage.submissions import OPEN
from wrongturn_service.storage.usage import Usage

Item = OwnerRow | AgentRow | EvaluationRow | SubmissionRow
ROWS: Final[dict[Collection, type[Item]]] = {
    Collection.OWNERS: OwnerRow,
    Collection.AGENTS: AgentRow,
    Collection.EVALUATIONS: EvaluationRow,
    Collection.SUBMISSIONS: SubmissionRow,
}


class After(NamedTuple):
    """Where a page begins: after the item that was made at this time and has this id."""

    created: float
    id: str


@dataclass(frozen=True)
class Filters:
    """What a list is narrowed to. None leaves a filter out.

    Attributes:
        name: Part of the name of the owner or the agent, in upper or lower case.
        owner: Id of the owner.
        agent: Id of the agent.
        suite: Id of the suite.
        state: State of the evaluation or the submission.
        hidden: Whether it is hidden itself.
    """

    name: str | None = None
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
class Doomed:
    """What is being deleted.

    Attributes:
        seq: Number of the entry in the audit log.
        name: Name of the target.
        owners: Ids of owners.
        agents: Ids of agents.
        evaluations: Ids of evaluations.
        submissions: Ids of submissions.
        cancelled: Ids of submissions that waited or ran, also of those that stay.
    """

    seq: int
    name: str
    owners: tuple[str, ...] = ()
    agents: tuple[str, ...] = ()
    evaluations: tuple[str, ...] = ()
    submissions: tuple[str, ...] = ()
    cancelled: tuple[str, ...] = ()


class AdministrationStore:
    """Reads and deletes for the operator. Each method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    async def page(self, collection: Collection, filters: Filters, after: After | None, limit: int) -> Sequence[Found]:
        """Return some items, newest first.

        Args:
            collection: What is listed.
            filters: What the list is narrowed to.
            after: Where the page begins. None for the first page.
            limit: Most items.
        """
        row = ROWS[collection]
        query = _found(collection).where(*_conditions(collection, filters))
        if after is not None:
            earlier = and_(row.created == after.created, row.id < after.id)
            query = query.where(or_(row.created < after.created, earlier))
        async with self._database.read() as session:
            found = await session.execute(query.order_by(row.created.desc(), row.id.desc()).limit(limit))
        return [Found(*one) for one in found.tuples()]

    async def item(self, collection: Collection, item_id: str) -> Found | None:
        """Return an item, or None."""
        async with self._database.read() as session:
            found = await session.execute(_found(collection).where(ROWS[collection].id == item_id))
        one = found.tuples().first()
        return None if one is None else Found(*one)

    async def id_of(self, collection: Collection, word: str) -> str | None:
        """Return the id of the owner or agent that has this id, or else this name in upper or lower case; or None."""
        row: Any = ROWS[collection]
        called = or_(row.id == word, row.name_key == word.lower())
        async with self._database.read() as session:
            found = (await session.scalars(select(row.id).where(called))).all()
        return max(found, key=lambda one: one == word, default=None)

    async def contents(self, collection: Collection, item_id: str) -> tuple[Contents, tuple[str, ...]]:
        """Return what hangs on an item, without its models, and the ids of the submissions that may have some."""
        async with self._database.read() as session:
            scope = await scope_of(session, collection, item_id)
            submissions = tuple((await session.scalars(select(SubmissionRow.id).where(scope.submissions))).all())
            return await contents.everything(session, collection, item_id), submissions

    async def hide(self, collection: Collection, item_id: str, act: Act, *, hidden: bool) -> int:
        """Hide an item, or show it again. Return 0 if nothing has changed."""
        row = ROWS[collection]
        async with self._database.write() as session:
            changed = await _changed(
                session,
                update(row).where(row.id == item_id, getattr(row, "hidden") != hidden).values(hidden=hidden),  # noqa: B009
            )
            if changed:
                action = AuditAction.HIDE if hidden else AuditAction.UNHIDE
                name = await _name(session, collection, item_id)
                contents = Contents(**{collection.value: 1})
                await audit.add(session, act.entry(action, collection, item_id, name, contents))
        return changed

    async def revoke(self, collection: Collection, item_id: str, act: Act) -> tuple[int, tuple[str, ...]]:
        """End the token of an agent, or those of an owner and its agents.

        Returns:
            The number of tokens that ended, and the ids of the agents among their holders.
        """
        async with self._database.write() as session:
            scope = await scope_of(session, collection, item_id)
            has_token = AgentRow.token_sha256.is_not(None)
            agents = tuple((await session.scalars(select(AgentRow.id).where(scope.agents, has_token))).all())
            await session.execute(update(AgentRow).where(AgentRow.id.in_(agents)).values(token_sha256=None))
            owners = 0
            if collection is Collection.OWNERS:
                of_owner = update(OwnerRow).where(OwnerRow.id == item_id, OwnerRow.token_sha256.is_not(None))
                owners = await _changed(session, of_owner.values(token_sha256=None))
            changed = len(agents) + owners
            if changed:
                name = await _name(session, collection, item_id)
                contents = Contents(owners=owners, agents=len(agents))
                await audit.add(session, act.entry(AuditAction.REVOKE, collection, item_id, name, contents))
        return changed, agents

    async def begin_deletion(self, collection: Collection, item_id: str, act: Act) -> Doomed | None:
        """Hide an item with all that hangs on it, end its tokens, and stop what runs. None if it is gone.

        From here on nothing of it is added. A deletion that is cut short after this leaves it hidden.
        """
        async with self._database.write() as session:
            if await session.get(ROWS[collection], item_id) is None:
                return None
            scope = await scope_of(session, collection, item_id)
            owners, agents, evaluations, submissions = [
                tuple((await session.scalars(select(row.id).where(where))).all())
                for row, where in (
                    (OwnerRow, scope.owners),
                    (AgentRow, scope.agents),
                    (EvaluationRow, scope.evaluations),
                    (SubmissionRow, scope.submissions),
                )
            ]
            open_ones = select(SubmissionRow.id).where(
                or_(scope.submissions, SubmissionRow.evaluation_id.in_(evaluations)), SubmissionRow.state.in_(OPEN)
            )
            cancelled = tuple((await session.scalars(open_ones)).all())
            await deletion.stop(session, scope, cancelled)
            name = await _name(session, collection, item_id)
            entry = act.entry(AuditAction.DELETE, collection, item_id, name, Contents(), done=False)
            await audit.add(session, entry)
            # Before the episodes: a reply is found by the episode that it began.
            await deletion.delete_replies(session, scope, collection, item_id, entry)
            return Doomed(entry.seq, name, owners, agents, evaluations, submissions, cancelled)

    async def delete_some(self, collection: Collection, item_id: str, seq: int) -> bool:
        """Delete some episodes with their trajectories. Return whether there may be more.

        Args:
            collection: Kind of the target.
            item_id: Id of the target.
            seq: Number of the entry in the audit log, which counts them.
        """
        async with self._database.write() as session:
            scope = await scope_of(session, collection, item_id)
            episodes = (await session.scalars(select(EpisodeRow.id).where(scope.episodes).limit(deletion.BATCH))).all()
            if not episodes:
                return False
            await deletion.delete_episodes(
                session, Scope(episodes=EpisodeRow.id.in_(episodes)), await deletion.entry_of(session, seq)
            )
            return len(episodes) == deletion.BATCH

    async def finish_deletion(
        self, collection: Collection, item_id: str, doomed: Doomed, models: Contents, *, free: bool
    ) -> tuple[Contents, tuple[str, ...]]:
        """Delete what is left of an item.

        Args:
            collection: Kind of the target.
            item_id: Id of the target.
            doomed: What :meth:`begin_deletion` returned.
            models: Files that were deleted already.
            free: Free names and places too.

        Returns:
            All that was deleted, and what stays taken.
        """
        async with self._database.write() as session:
            scope = await scope_of(session, collection, item_id)
            if not free:
                await deletion.hold(session, collection, item_id, scope)
            entry = await deletion.entry_of(session, doomed.seq)
            await deletion.delete_replies(session, scope, collection, item_id, entry)
            await deletion.delete_episodes(session, scope, entry)
            deletion.note(entry, await counted(session, scope), models)
            owner = await contents.owner_of_item(session, collection, item_id)
            await deletion.delete_rest(session, scope)
            if owner is not None:
                await Usage().recount(session, owner)
            entry.done = True
            deleted = Contents.model_validate_json(entry.counts)
            return deleted, await held.held_by(session, item_id)

    async def deleted_before(
        self, collection: Collection, item_id: str, act: Act, *, free: bool
    ) -> tuple[str, tuple[str, ...]] | None:
        """Return the name of an item that was deleted earlier, and what stays taken; None if it never was there.

        Args:
            collection: Kind of the target.
            item_id: Id of the target.
            act: Who asks.
            free: Free now what the deletion kept taken.
        """
        async with self._database.write() as session:
            known = select(AuditRow).where(
                AuditRow.target == item_id, AuditRow.kind == collection, AuditRow.action == AuditAction.DELETE
            )
            entry = await session.scalar(known.order_by(AuditRow.seq.desc()).limit(1))
            if entry is None:
                return None
            if free and await held.free(session, item_id):
                await audit.add(session, act.entry(AuditAction.FREE, collection, item_id, entry.name, Contents()))
            return entry.name, await held.held_by(session, item_id)

    async def suites_of(self, collection: Collection, item_id: str) -> set[str]:
        """Return the suites on which an item has evaluations."""
        async with self._database.read() as session:
            scope = await scope_of(session, collection, item_id)
            return set((await session.scalars(select(EvaluationRow.suite).where(scope.evaluations).distinct())).all())

    async def usage(self, begin: int, limit: int) -> tuple[list[tuple[str, str, Contents]], Contents]:
        """Return some owners with what they have stored, and the sum. See :func:`contents.usage`."""
        async with self._database.read() as session:
            return await contents.usage(session, begin, limit)


def _found(collection: Collection) -> Any:
    match collection:
        case Collection.OWNERS:
            return select(OwnerRow, OwnerRow.name, OwnerRow.id)
        case Collection.AGENTS:
            return select(AgentRow, AgentRow.name, AgentRow.owner_id)
        case Collection.EVALUATIONS:
            agent = AgentRow.id == EvaluationRow.agent_id
            return select(EvaluationRow, AgentRow.name, AgentRow.owner_id).join(AgentRow, agent)
        case Collection.SUBMISSIONS:
            return select(SubmissionRow, SubmissionRow.name, SubmissionRow.owner_id)


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


async def _changed(session: AsyncSession, statement: Any) -> int:
    return int(getattr(await session.execute(statement), "rowcount", 0))
