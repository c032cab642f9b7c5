"""Agents and their tokens."""

import time

import orjson
from fastapi import APIRouter, Request, Response

from wrongturn_protocol import AgentDetail, AgentList, AgentRegistration, RegisteredAgent
from wrongturn_service.accounts import bearer, detail
from wrongturn_service.api.body import parsed
from wrongturn_service.api.dependencies import address_of, key_of, reply, service_of
from wrongturn_service.api.documents import described
from wrongturn_service.encoding import Encoding
from wrongturn_service.storage.models import AgentRow, IdempotencyRow
from wrongturn_service.tokens import digest, new_id, new_token, unseal

router = APIRouter(prefix="/v1/agents", tags=["agents"])


@router.post("", **described(RegisteredAgent, 403, 409, 429, status=201, body=AgentRegistration, creates=True))
async def register(request: Request) -> Response:
    """Register an agent. The token is shown this once; a new model is a new agent."""
    service = service_of(request)
    registration = await parsed(request, AgentRegistration)
    canonical = registration.model_dump_json().encode()
    # Before there is a token, a key belongs to who knows it; its reply is sealed by it.
    async with service.idempotency.once(key_of(request), "registration", "POST /v1/agents", canonical) as once:
        if once.stored is not None:
            return _with_token(once.stored, once.key)
        operator = service.accounts.is_operator(request.headers.get("authorization"))
        service.accounts.check_registration(registration, operator=operator, address=address_of(request))
        token = new_token()
        row = AgentRow(
            id=new_id("ag"),
            name=registration.name,
            name_key=registration.name.lower(),
            track=registration.track.value,
            kind=registration.kind.value,
            description=registration.description,
            homepage=registration.homepage,
            token_sha256=digest(token),
            created=time.time(),
        )
        agent = detail(row)
        remember = once.remember(201, Encoding.JSON, token)
        await service.accounts.register(row, remember(agent.model_dump_json().encode()) if remember else None)
    return reply(RegisteredAgent(**agent.model_dump(), token=token), 201)


@router.get("", **described(AgentList))
async def agents(request: Request) -> Response:
    """All agents, by name."""
    rows = await service_of(request).store.agents()
    return reply(AgentList(agents=tuple(detail(row) for row in rows)))


@router.get("/{agent}", **described(AgentDetail, 404))
async def agent(request: Request, agent: str) -> Response:
    """One agent."""
    return reply(detail(await service_of(request).accounts.agent(agent)))


@router.post("/{agent}/token", **described(RegisteredAgent, 404, status=201, token=True, creates=True))
async def rotate(request: Request, agent: str) -> Response:
    """A new token, shown this once; the old one ends. For the owner or the operator."""
    service = service_of(request)
    authorization = request.headers.get("authorization")
    # The key is the old token's, which no longer opens anything when the request is repeated.
    scope = digest(bearer(authorization))
    async with service.idempotency.once(key_of(request), scope, f"POST /v1/agents/{agent}/token", b"") as once:
        if once.stored is not None:
            return _with_token(once.stored, once.key)
        found = detail(await service.accounts.owned_agent(agent, authorization))
        token = new_token()
        remember = once.remember(201, Encoding.JSON, token)
        stored = remember(found.model_dump_json().encode()) if remember else None
        await service.accounts.set_token(agent, token, stored)
    return reply(RegisteredAgent(**found.model_dump(), token=token), 201)


@router.delete("/{agent}/token", **described(None, 404, status=204, token=True))
async def revoke(request: Request, agent: str) -> Response:
    """End the agent's token. For the owner or the operator, who alone can give a new one then."""
    service = service_of(request)
    await service.accounts.owned_agent(agent, request.headers.get("authorization"))
    await service.accounts.set_token(agent, None)
    return Response(status_code=204)


def _with_token(stored: IdempotencyRow, key: str | None) -> Response:
    assert stored.sealed_token is not None
    assert key is not None
    message = {**orjson.loads(stored.body), "token": unseal(stored.sealed_token, key)}
    return reply(RegisteredAgent.model_validate(message, strict=False), stored.status)
