"""The operator's calls: lists of everything, hiding, revoking, deleting, usage and the audit log."""

import math
import re
from dataclasses import replace
from datetime import UTC, datetime
from typing import Annotated, Any, Final

from fastapi import APIRouter, Query, Request, Response, Security

from wrongturn_protocol import AgentKind, EvaluationState, SubmissionState, Track
from wrongturn_protocol.administration import (
    AdminDetail,
    AdminItem,
    AdminList,
    AuditEntry,
    AuditList,
    Change,
    Contents,
    Deletion,
    OwnerUsage,
    UsageList,
)
from wrongturn_protocol.vocabulary import AuditAction, Collection
from wrongturn_service import catalogue
from wrongturn_service.api.dependencies import ServiceDep, Token, reply, service_of
from wrongturn_service.api.documents import Route, described
from wrongturn_service.api.paging import PageDep, Wanted, not_of_this_list
from wrongturn_service.errors import InvalidRequestError, unknown
from wrongturn_service.service import Service
from wrongturn_service.storage.administration import Act, After, Filters, Found
from wrongturn_service.storage.models import AgentRow, AuditRow, EvaluationRow, OwnerRow, SubmissionRow

router = APIRouter(prefix="/v1/admin", tags=["admin"], route_class=Route)
_FILTERS: Final[dict[Collection, frozenset[str]]] = {
    Collection.OWNERS: frozenset({"name", "hidden"}),
    Collection.AGENTS: frozenset({"name", "owner", "hidden"}),
    Collection.EVALUATIONS: frozenset({"name", "owner", "agent", "suite", "state", "hidden"}),
    Collection.SUBMISSIONS: frozenset({"name", "owner", "agent", "suite", "state"}),
}
"""What each list can be narrowed to."""
_STATES: Final = {Collection.EVALUATIONS: EvaluationState, Collection.SUBMISSIONS: SubmissionState}
_NAMED: Final = {one.one: one for one in (Collection.OWNERS, Collection.AGENTS)}
_ID: Final = re.compile(r"(?:ow|ag|ev|su)_[0-9a-z]+")
Word = Annotated[str | None, Query(max_length=160, pattern="^[^\\x00]*$")]
Reason = Annotated[str | None, Query(max_length=500, pattern="^[^\\x00]*$", description="Why, for the audit log.")]


class Operator(Token):
    """Checks that the operator calls. Raises UnauthenticatedError, ForbiddenError."""

    async def __call__(self, request: Request) -> Act:  # type: ignore[override]
        """Return who acts, and from where."""
        return await (await service_of(request)).administration.act_of(request)


class Acting(Operator):
    """The same for calls that change something."""

    async def __call__(self, request: Request, reason: Reason = None) -> Act:  # type: ignore[override]
        """Return who acts, from where, and why."""
        return replace(await super().__call__(request), reason=reason)


OperatorDep = Annotated[Act, Security(Operator())]
ActDep = Annotated[Act, Security(Acting())]


@router.get("/usage", **described(UsageList, 422))
async def usage(service: ServiceDep, _: OperatorDep, wanted: PageDep) -> Response:
    """Show what each owner has stored, those with the most bytes first. Its quota counts the same bytes."""
    begin = wanted.number or 0
    found, everything = await service.administration.rows.usage(begin, wanted.limit + 1)
    page, following = wanted.cut(found, lambda _: begin + wanted.limit)
    owners = tuple(OwnerUsage(id=owner, name=name, contents=contents) for owner, name, contents in page)
    return reply(UsageList(owners=owners, total=everything, next=following))


@router.get("/audit", **described(AuditList, 422))
async def audit(
    service: ServiceDep, _: OperatorDep, wanted: PageDep, target: Word = None, action: AuditAction | None = None
) -> Response:
    """List what the operator did, newest first: who, when, from where, what, and how many of each kind.

    A target is an id, or ``owner:NAME`` or ``agent:NAME``, also of one that was deleted.
    """
    item, named = _target(target)
    before, most = wanted.number, wanted.limit + 1
    rows = await service.administration.rows.entries(before=before, limit=most, target=item, named=named, action=action)
    page, following = wanted.cut(rows, lambda row: row.seq)
    return reply(AuditList(entries=tuple(_entry(row) for row in page), next=following))


@router.get("/{collection}", **described(AdminList, 404, 422))
async def items(
    service: ServiceDep,
    _: OperatorDep,
    collection: Collection,
    wanted: PageDep,
    name: Word = None,
    owner: Word = None,
    agent: Word = None,
    suite: Word = None,
    state: Word = None,
    hidden: bool | None = None,
) -> Response:
    """List owners, agents, evaluations or submissions, newest first, hidden ones too.

    An owner or an agent is named by its id or its name.
    """
    given = Filters(name, owner, agent, suite, state, hidden)
    for field, value in vars(given).items():
        if value is not None and field not in _FILTERS[collection]:
            allowed = ", ".join(sorted(_FILTERS[collection]))
            raise InvalidRequestError(f"query.{field}", f"{collection} cannot be narrowed to it; use {allowed}")
    filters = await _checked(service, collection, given)
    rows = await service.administration.rows.page(collection, filters, _after(wanted), wanted.limit + 1)
    page, following = wanted.cut(rows, lambda found: f"{found.row.created!r} {found.row.id}")
    return reply(AdminList(items=tuple(AdminItem(**_fields(row)) for row in page), next=following))


@router.get("/{collection}/{item}", **described(AdminDetail, 404, 422))
async def item(service: ServiceDep, _: OperatorDep, collection: Collection, item: str) -> Response:
    """Show one of them, and what a deletion would delete with it."""
    found = await service.administration.item(collection, item)
    contents = await service.administration.rows.contents(collection, item)
    return reply(AdminDetail(**_fields(found), contents=contents))


@router.put("/{collection}/{item}/hidden", **described(Change, 404, 422))
async def hide(service: ServiceDep, act: ActDep, collection: Collection, item: str) -> Response:
    """Hide an owner, an agent or an evaluation from everybody but its owner and the operator. Safe to send again.

    What is hidden is on no leaderboard, page or list, and still counts as the agent's first evaluation.
    """
    return reply(Change(id=item, changed=await service.administration.hide(collection, item, act, hidden=True)))


@router.delete("/{collection}/{item}/hidden", **described(Change, 404, 422))
async def unhide(service: ServiceDep, act: ActDep, collection: Collection, item: str) -> Response:
    """Show what was hidden again. Safe to send again."""
    return reply(Change(id=item, changed=await service.administration.hide(collection, item, act, hidden=False)))


@router.delete("/{collection}/{item}/tokens", **described(Change, 404, 422))
async def revoke(service: ServiceDep, act: ActDep, collection: Collection, item: str) -> Response:
    """End an agent's token, or those of an owner and all its agents. Safe to send again."""
    return reply(Change(id=item, changed=await service.administration.revoke(collection, item, act)))


@router.delete("/{collection}/{item}", **described(Deletion, 404, 422))
async def delete(
    service: ServiceDep,
    act: ActDep,
    collection: Collection,
    item: str,
    free: Annotated[bool, Query(description="Give back the names, and the agent's place on the suite.")] = False,
) -> Response:
    """Delete one of them for good, with all that hangs on it. Safe to send again. What runs of it ends at once.

    Names stay taken, and an agent whose first evaluation is deleted gets no other that counts, unless ``free`` says so.
    """
    return reply(await service.administration.delete(collection, item, act, free=free))


async def _checked(service: Service, collection: Collection, given: Filters) -> Filters:
    """Return filters with ids instead of names. Raises InvalidRequestError, NotFoundError for what does not exist."""
    if given.state is not None:
        states = [state.value for state in _STATES[collection]]
        if given.state not in states:
            raise InvalidRequestError("query.state", f"has to be {', '.join(states[:-1])} or {states[-1]}")
    if given.suite is not None:
        catalogue.suite(given.suite)
    owner = await _id(service, Collection.OWNERS, given.owner)
    return replace(given, owner=owner, agent=await _id(service, Collection.AGENTS, given.agent))


async def _id(service: Service, collection: Collection, word: str | None) -> str | None:
    """Return the id of an owner or an agent by its id or its name. Raises NotFoundError."""
    if word is None:
        return None
    name = word.removeprefix(f"{collection.one}:")
    found = await service.administration.rows.id_of(collection, name)
    if found is None:
        raise unknown(collection, name)
    return found


def _target(target: str | None) -> tuple[str | None, tuple[Collection, str] | None]:
    """Return the id, or the kind and the name, of a target of the audit log. Raises InvalidRequestError."""
    if target is None or _ID.fullmatch(target):
        return target, None
    kind, separator, name = target.partition(":")
    if not separator or kind not in _NAMED:
        raise InvalidRequestError("query.target", "has to be an id, such as ag_…, or owner:NAME or agent:NAME")
    return None, (_NAMED[kind], name)


def _fields(found: Found) -> dict[str, Any]:
    row = found.row
    shared = {"id": row.id, "name": found.name, "created": _iso(row.created)}
    match row:
        case OwnerRow():
            return {**shared, "hidden": row.hidden, "token": row.token_sha256 is not None, "contact": row.contact}
        case AgentRow():
            flags = {"hidden": row.hidden, "token": row.token_sha256 is not None}
            return {**shared, **flags, "owner": found.owner, "track": Track(row.track), "kind": AgentKind(row.kind)}
        case EvaluationRow():
            told = {"owner": found.owner, "agent": row.agent_id, "suite": row.suite, "state": row.state}
            return {**shared, **told, "hidden": row.hidden}
        case SubmissionRow():
            told = {"owner": found.owner, "agent": row.agent_id, "suite": row.suite, "state": row.state}
            return {**shared, **told, "evaluation": row.evaluation_id, "reason": row.reason}


def _entry(row: AuditRow) -> AuditEntry:
    return AuditEntry(
        seq=row.seq,
        time=_iso(row.time),
        actor=row.actor,
        address=row.address,
        action=AuditAction(row.action),
        collection="keys" if row.kind == "keys" else Collection(row.kind),
        target=row.target,
        name=row.name,
        reason=row.reason,
        contents=Contents.model_validate_json(row.counts),
    )


def _after(wanted: Wanted) -> After | None:
    """Return where a page begins. Raises InvalidRequestError."""
    if wanted.after is None:
        return None
    created, _, item_id = wanted.after.partition(" ")
    try:
        after = After(float(created), item_id)
    except ValueError:
        raise not_of_this_list() from None
    if not math.isfinite(after.created):
        raise not_of_this_list()
    return after


def _iso(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")
