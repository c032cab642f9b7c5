"""Agents and their tokens."""

import time
from typing import Annotated, Final

from fastapi import APIRouter, Depends, Query, Request, Response

from wrongturn_protocol import AgentDetail, AgentList, AgentRegistration, RegisteredAgent
from wrongturn_protocol.vocabulary import AuditAction, Collection
from wrongturn_service.accounts import bearer, detail
from wrongturn_service.api.dependencies import AuthorizationDep, Body, KeyDep, ServiceDep, reply
from wrongturn_service.api.documents import WITHOUT_TOKEN_TOO, Route, described
from wrongturn_service.api.paging import PageDep
from wrongturn_service.client_address import address_of
from wrongturn_service.encoding import Encoding
from wrongturn_service.storage.models import AgentRow
from wrongturn_service.tokens import digest, new_id, new_token

_LARGEST: Final = 32768
"""Bytes of a registration: those of the longest description, if each character is escaped as two times six."""
router = APIRouter(prefix="/v1/agents", tags=["agents"], route_class=Route)


@router.post("", **described(RegisteredAgent, 401, 403, 409, 429, 507, status=201))
async def register(
    request: Request,
    service: ServiceDep,
    registration: Annotated[AgentRegistration, Depends(Body(AgentRegistration, limit=_LARGEST))],
    key: KeyDep,
) -> Response:
    """Register an agent. The reply shows the token once. A new model is a new agent.

    With an owner's token the agent is that owner's. Without a token an owner of the agent's name is made.
    """
    advice = "register agents with their owner's token, or without one"
    who = await service.registrations.registrant(request.headers.get("authorization"), address_of(request), advice)
    async with key.once(who.scope, registration) as once:
        service.registrations.check_agent(registration, who)
        owner = await service.registrations.owner_for(registration, who)
        token = new_token()
        row = AgentRow(
            id=new_id("ag"),
            name=registration.name,
            name_key=registration.name.lower(),
            track=registration.track.value,
            kind=registration.kind.value,
            description=registration.description,
            homepage=registration.homepage,
            trained_on_faults=registration.trained_on_faults,
            token_sha256=digest(token),
            created=time.time(),
            owner=owner,
        )
        agent = detail(row)
        remember = once.remember(201, Encoding.JSON, with_token=True)
        await service.registrations.add_agent(row, remember(agent.model_dump_json().encode()) if remember else None)
    return reply(RegisteredAgent(**agent.model_dump(), token=token), 201)


@router.get("", **described(AgentList, 422))
async def agents(
    service: ServiceDep,
    page: PageDep,
    everybody: Annotated[
        bool, Query(alias="all", description="Whether to list agents without an evaluation too")
    ] = False,
) -> Response:
    """List the agents by name. Those that have only practised are left out unless you ask for all."""
    rows = await service.store.agents(evaluated=not everybody, after=page.after, limit=page.limit + 1)
    found, following = page.cut(rows, lambda row: row.name_key)
    return reply(AgentList(agents=tuple(detail(row) for row in found), next=following))


@router.get("/{agent}", **described(AgentDetail, 404), **WITHOUT_TOKEN_TOO)
async def agent(service: ServiceDep, authorization: AuthorizationDep, agent: str) -> Response:
    """Show one agent. One that the operator hides is shown to itself, its owner and the operator."""
    return reply(detail(await service.accounts.shown_agent(agent, authorization)))


@router.post("/{agent}/token", **described(RegisteredAgent, 404, 507, status=201))
async def rotate(
    request: Request, service: ServiceDep, agent: str, authorization: AuthorizationDep, key: KeyDep
) -> Response:
    """Make a new token and show it once. The old one ends. For the agent itself, its owner or the operator."""
    # The key belongs to the old token, which no longer opens anything when the request is repeated.
    async with key.once(digest(bearer(authorization))) as once:
        row = await service.accounts.owned_agent(agent, authorization)
        found = detail(row)
        token = new_token()
        remember = once.remember(201, Encoding.JSON, with_token=True)
        stored = remember(found.model_dump_json().encode()) if remember else None
        await service.accounts.set_token(agent, token, stored)
        await service.administration.note(
            authorization, address_of(request), AuditAction.ROTATE, Collection.AGENTS, row
        )
    return reply(RegisteredAgent(**found.model_dump(), token=token), 201)


@router.delete("/{agent}/token", **described(None, 404, status=204))
async def revoke(request: Request, service: ServiceDep, agent: str, authorization: AuthorizationDep) -> Response:
    """End the agent's token. For the agent itself, its owner or the operator, who can also make a new one."""
    row = await service.accounts.owned_agent(agent, authorization)
    await service.accounts.set_token(agent, None)
    await service.administration.note(authorization, address_of(request), AuditAction.REVOKE, Collection.AGENTS, row)
    return Response(status_code=204)
