"""Owners, who answer for agents, the agents, and their tokens."""

import time
from typing import Annotated, Final

from fastapi import APIRouter, Depends, Query, Request, Response

from wrongturn_protocol import (
    AgentDetail,
    AgentList,
    AgentRegistration,
    OwnerDetail,
    OwnerList,
    OwnerRegistration,
    RegisteredAgent,
    RegisteredOwner,
)
from wrongturn_protocol.vocabulary import AuditAction, Collection
from wrongturn_service.accounts import bearer, detail
from wrongturn_service.api.dependencies import AuthorizationDep, Body, KeyDep, RequestKey, ServiceDep, reply
from wrongturn_service.api.documents import WITHOUT_TOKEN_TOO, Route, described
from wrongturn_service.api.paging import PageDep
from wrongturn_service.client_address import address_of
from wrongturn_service.encoding import Encoding
from wrongturn_service.idempotency import IdempotentRequest
from wrongturn_service.registration import new_owner, owner_detail
from wrongturn_service.service import Service
from wrongturn_service.storage.models import AgentRow, IdempotencyRow, OwnerRow
from wrongturn_service.tokens import digest, new_id, new_token

_LARGEST: Final = 32768
"""Bytes of a registration: those of the longest description, if each character is escaped as two times six."""
owners_router = APIRouter(prefix="/v1/owners", tags=["owners"], route_class=Route)
agents_router = APIRouter(prefix="/v1/agents", tags=["agents"], route_class=Route)


@owners_router.post("", name="register", **described(RegisteredOwner, 401, 403, 409, 429, 507, status=201))
async def register_owner(
    request: Request,
    service: ServiceDep,
    registration: Annotated[OwnerRegistration, Depends(Body(OwnerRegistration, limit=8192))],
    key: KeyDep,
) -> Response:
    """Register an owner. The reply shows the token once. With it the owner registers agents."""
    service.check_disk()
    advice = "register an owner without a token, or with the operator's"
    who = await service.registrations.registrant(request.headers.get("authorization"), address_of(request), advice)
    async with key.once(who.scope, registration) as once:
        service.registrations.check_owner(registration, who)
        token = new_token()
        row = new_owner(registration.name, registration.contact, token, who.origin)
        await service.registrations.add_owner(row, _stored(once, row))
        service.lists.clear()
    return _with_token(row, token)


@agents_router.post("", **described(RegisteredAgent, 401, 403, 409, 429, 507, status=201))
async def register(
    request: Request,
    service: ServiceDep,
    registration: Annotated[AgentRegistration, Depends(Body(AgentRegistration, limit=_LARGEST))],
    key: KeyDep,
) -> Response:
    """Register an agent. The reply shows the token once. A new model is a new agent.

    With an owner's token the agent is that owner's. Without a token an owner of the agent's name is made.
    """
    service.check_disk()
    advice = "register agents with their owner's token, or without one"
    who = await service.registrations.registrant(request.headers.get("authorization"), address_of(request), advice)
    async with key.once(who.scope, registration) as once:
        service.registrations.check_agent(registration, who)
        token = new_token()
        row = AgentRow(
            id=new_id("ag"),
            name=registration.name,
            name_key=registration.name.lower(),
            track=registration.track.value,
            rig=registration.rig and registration.rig.text,
            kind=registration.kind.value,
            description=registration.description,
            homepage=registration.homepage,
            trained_on_faults=registration.trained_on_faults,
            token_sha256=digest(token),
            created=time.time(),
            owner=await service.registrations.owner_for(registration, who),
        )
        await service.registrations.add_agent(row, _stored(once, row))
        service.lists.clear()
    return _with_token(row, token)


@owners_router.get("", **described(OwnerList, 422))
async def owners(service: ServiceDep, page: PageDep) -> Response:
    """List the owners by name."""

    async def made() -> bytes:
        rows = await service.store.owners(after=page.after, limit=page.limit + 1)
        found, following = page.cut(rows, lambda row: row.name_key)
        return OwnerList(owners=tuple(map(owner_detail, found)), next=following).model_dump_json().encode()

    return Response(await service.lists.get(("owners", page), made), media_type=Encoding.JSON)


@agents_router.get("", **described(AgentList, 422))
async def agents(
    service: ServiceDep,
    page: PageDep,
    everybody: Annotated[
        bool, Query(alias="all", description="Whether to list agents without an evaluation too")
    ] = False,
) -> Response:
    """List the agents by name. Those that have only practised are left out unless you ask for all."""

    async def made() -> bytes:
        rows = await service.store.agents(evaluated=not everybody, after=page.after, limit=page.limit + 1)
        found, following = page.cut(rows, lambda row: row.name_key)
        return AgentList(agents=tuple(map(detail, found)), next=following).model_dump_json().encode()

    return Response(await service.lists.get(("agents", page, everybody), made), media_type=Encoding.JSON)


@owners_router.get("/{owner}", **described(OwnerDetail, 404), **WITHOUT_TOKEN_TOO)
async def owner(service: ServiceDep, authorization: AuthorizationDep, owner: str) -> Response:
    """Show one owner. One that the operator hides is shown to itself and the operator."""
    return reply(_shown(await service.accounts.shown(Collection.OWNERS, owner, authorization)))


@agents_router.get("/{agent}", **described(AgentDetail, 404), **WITHOUT_TOKEN_TOO)
async def agent(service: ServiceDep, authorization: AuthorizationDep, agent: str) -> Response:
    """Show one agent. One that the operator hides is shown to itself, its owner and the operator."""
    return reply(_shown(await service.accounts.shown(Collection.AGENTS, agent, authorization)))


@owners_router.post("/{owner}/token", name="rotate", **described(RegisteredOwner, 404, 507, status=201))
async def rotate_owner(request: Request, service: ServiceDep, owner: str, _: AuthorizationDep, key: KeyDep) -> Response:
    """Make a new token and show it once. The old one ends. For the owner itself or the operator."""
    return await _rotate(request, service, Collection.OWNERS, owner, key)


@agents_router.post("/{agent}/token", **described(RegisteredAgent, 404, 507, status=201))
async def rotate(request: Request, service: ServiceDep, agent: str, _: AuthorizationDep, key: KeyDep) -> Response:
    """Make a new token and show it once. The old one ends. For the agent itself, its owner or the operator."""
    return await _rotate(request, service, Collection.AGENTS, agent, key)


@owners_router.delete("/{owner}/token", name="revoke", **described(None, 404, status=204))
async def revoke_owner(request: Request, service: ServiceDep, owner: str, _: AuthorizationDep) -> Response:
    """End the owner's token. For the owner itself or the operator. Only the operator can make a new one then."""
    return await _revoke(request, service, Collection.OWNERS, owner)


@agents_router.delete("/{agent}/token", **described(None, 404, status=204))
async def revoke(request: Request, service: ServiceDep, agent: str, _: AuthorizationDep) -> Response:
    """End the agent's token. For the agent itself, its owner or the operator, who can also make a new one."""
    return await _revoke(request, service, Collection.AGENTS, agent)


async def _rotate(request: Request, service: Service, collection: Collection, item: str, key: RequestKey) -> Response:
    authorization = request.headers.get("authorization")
    # The key belongs to the old token, which no longer opens anything when the request is repeated.
    async with key.once(digest(bearer(authorization))) as once:
        row = await service.accounts.own(collection, item, authorization)
        token = new_token()
        await service.accounts.set_token(row, token, _stored(once, row))
        await service.administration.note(request, AuditAction.ROTATE, collection, row)
    return _with_token(row, token)


async def _revoke(request: Request, service: Service, collection: Collection, item: str) -> Response:
    row = await service.accounts.own(collection, item, request.headers.get("authorization"))
    await service.accounts.set_token(row, None)
    await service.administration.note(request, AuditAction.REVOKE, collection, row)
    return Response(status_code=204)


def _shown(row: OwnerRow | AgentRow) -> OwnerDetail | AgentDetail:
    return owner_detail(row) if isinstance(row, OwnerRow) else detail(row)


def _stored(once: IdempotentRequest, row: OwnerRow | AgentRow) -> IdempotencyRow | None:
    """Return the reply that is stored for the request's key: all but the token."""
    return once.row(_shown(row).model_dump_json().encode(), 201, Encoding.JSON, with_token=True)


def _with_token(row: OwnerRow | AgentRow, token: str) -> Response:
    kind = RegisteredOwner if isinstance(row, OwnerRow) else RegisteredAgent
    return reply(kind(**_shown(row).model_dump(), token=token), 201)
