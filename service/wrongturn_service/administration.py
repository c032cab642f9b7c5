"""What the operator does: hiding, ending tokens, and deleting with all that hangs on it."""

import asyncio

import structlog
from starlette.requests import HTTPConnection

from wrongturn_protocol import SubmissionState
from wrongturn_protocol.administration import Contents, Deletion
from wrongturn_protocol.vocabulary import AuditAction, Collection
from wrongturn_service.accounts import Accounts
from wrongturn_service.cache import Cache
from wrongturn_service.client_address import address_of
from wrongturn_service.episodes.resets import Closings
from wrongturn_service.errors import ForbiddenError, InvalidRequestError, unknown
from wrongturn_service.evaluation.leaderboards import Leaderboards
from wrongturn_service.registration import SHIPPED
from wrongturn_service.replays import Replays
from wrongturn_service.storage.administration import Act, AdministrationStore, Found
from wrongturn_service.storage.models import AgentRow, OwnerRow, SubmissionRow
from wrongturn_service.submissions.operations import Submissions


class Administration:
    """Changes what others own. Every change is in the audit log. ``rows`` is the database."""

    def __init__(
        self,
        rows: AdministrationStore,
        accounts: Accounts,
        submissions: Submissions,
        closings: Closings,
        leaderboards: Leaderboards,
        replays: Replays,
        cache: Cache,
        lists: Cache,
    ) -> None:
        self.rows = rows
        self._accounts = accounts
        self._submissions = submissions
        self._closings = closings
        self._leaderboards = leaderboards
        self._replays = replays
        self._cache = cache
        self._lists = lists
        self._deleting = asyncio.Lock()
        self._log = structlog.get_logger("administration")

    async def item(self, collection: Collection, item_id: str) -> Found:
        """Return an item. Raises NotFoundError."""
        found = None if "\0" in item_id else await self.rows.item(collection, item_id)
        if found is None:
            raise unknown(collection, item_id)
        return found

    async def hide(self, collection: Collection, item_id: str, act: Act, *, hidden: bool) -> int:
        """Hide an item from everybody but its owner and the operator, or show it again. Safe to call again.

        Return 1 if that has changed anything, else 0. Raises NotFoundError; InvalidRequestError for a submission, which
        is never public; ForbiddenError for the owner of the shipped agents.
        """
        if collection is Collection.SUBMISSIONS:
            raise InvalidRequestError("collection", "submissions are never public; hide the agent or its evaluation")
        _check_not_shipped(await self.item(collection, item_id))
        changed = await self.rows.hide(collection, item_id, act, hidden=hidden)
        if changed:
            self._leaderboards.forget_all()
            self._lists.clear()
            self._log.warning("hidden" if hidden else "shown again", kind=collection.one, id=item_id)
        return changed

    async def revoke(self, collection: Collection, item_id: str, act: Act) -> int:
        """End an agent's token, or those of an owner and its agents; return how many ended. Safe to call again.

        Raises NotFoundError; InvalidRequestError for what is neither an owner nor an agent.
        """
        if collection not in {Collection.OWNERS, Collection.AGENTS}:
            raise InvalidRequestError("collection", f"{collection} have no tokens; revoke those of owners or agents")
        await self.item(collection, item_id)
        changed, agents = await self.rows.revoke(collection, item_id, act)
        await self._accounts.forget(agents)
        if changed:
            self._log.warning("tokens revoked", kind=collection.one, id=item_id, count=changed)
        return changed

    async def delete(self, collection: Collection, item_id: str, act: Act, *, free: bool) -> Deletion:
        """Delete an item with all that hangs on it, and end what runs of it. Safe to call again.

        Names and places on suites stay taken, unless ``free`` gives them back.

        Raises NotFoundError if there never was such an item; ForbiddenError for the owner of the shipped agents.
        """
        if "\0" in item_id:
            raise unknown(collection, item_id)
        async with self._deleting:
            found = await self.rows.item(collection, item_id)
            if found is not None:
                _check_not_shipped(found)
            counts = await self.rows.contents(collection, item_id)
            while await self.rows.delete_trajectories(collection, item_id):
                pass
            deleted = await self.rows.delete(collection, item_id, counts, act, free=free)
            if deleted is None:
                before = await self.rows.deleted_before(collection, item_id, act, free=free)
                if before is None:
                    raise unknown(collection, item_id)
                self._leaderboards.forget_all()  # a place may be free now
                name, held = before
                return Deletion(id=item_id, name=name, deleted=Contents(), held=held)
            self._leaderboards.forget_all()
            self._cache.clear()
            self._lists.clear()
            self._replays.clear()
            holders = {*deleted.agents, *deleted.submissions, *deleted.cancelled}
            await self._accounts.forget(holders)
            for submission in deleted.cancelled:
                self._submissions.note_end(submission, SubmissionState.CANCELLED)
            await self._closings.drop(deleted.evaluations, holders)
            for submission in deleted.submissions:
                await asyncio.to_thread(self._submissions.files.delete, submission)
        self._log.warning("deleted", kind=collection.one, id=item_id, **counts.model_dump(exclude_defaults=True))
        return Deletion(id=item_id, name=deleted.name, deleted=counts, held=deleted.held)

    async def act_of(self, request: HTTPConnection, reason: str | None = None) -> Act:
        """Return who acts as the operator, and from where. Raises UnauthenticatedError, ForbiddenError."""
        return Act(await self._accounts.operator(request.headers.get("authorization")), address_of(request), reason)

    async def note(
        self,
        request: HTTPConnection,
        action: AuditAction,
        collection: Collection,
        row: OwnerRow | AgentRow | SubmissionRow,
    ) -> None:
        """Write down what the operator did by a call that others have too. Calls of others are not written down."""
        if self._accounts.is_operator(request.headers.get("authorization")):
            await self.rows.note(await self.act_of(request), action, collection, row, row.name)


def _check_not_shipped(found: Found) -> None:
    if isinstance(found.row, OwnerRow) and found.row.name == SHIPPED:
        raise ForbiddenError(
            f"owner {SHIPPED} has the shipped agents, so it stays; hide or delete its agents one by one"
        )
