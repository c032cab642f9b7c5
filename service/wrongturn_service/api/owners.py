"""Owners, who answer for agents, and their tokens."""

from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response

from wrongturn_protocol import OwnerDetail, OwnerList, OwnerRegistration, RegisteredOwner
from wrongturn_protocol.vocabulary import AuditAction, Collection
from wrongturn_service.accounts import bearer
from wrongturn_service.api.dependencies import AuthorizationDep, Body, KeyDep, ServiceDep, reply
from wrongturn_service.api.documents import WITHOUT_TOKEN_TOO, Route, described
from wrongturn_service.api.paging import PageDep
from wrongturn_service.client_address import address_of
from wrongturn_service.encoding import Encoding
from wrongturn_service.registration import new_owner, owner_detail
from wrongturn_service.tokens import digest, new_token

router = APIRouter(prefix="/v1/owners", tags=["owners"], route_class=Route)


@router.post("", **described(RegisteredOwner, 401, 403, 409, 429, 507, status=201))
async def register(
    request: Request,
    service: ServiceDep,
    registration: Annotated[OwnerRegistration, Depends(Body(OwnerRegistration, limit=8192))],
    key: KeyDep,
) -> Response:
    """Register an owner. The reply shows the token once. With it the owner registers agents."""
    advice = "register an owner without a token, or with the operator's"
    who = await service.registrations.registrant(request.headers.get("authorization"), address_of(request), advice)
    async with key.once(who.scope, registration) as once:
        service.registrations.check_owner(registration, who)
        token = new_token()
        row = new_owner(registration.name, registration.contact, token, who.origin)
        owner = owner_detail(row)
        remember = once.remember(201, Encoding.JSON, with_token=True)
        await service.registrations.add_owner(row, remember(owner.model_dump_json().encode()) if remember else None)
    return reply(RegisteredOwner(**owner.model_dump(), token=token), 201)


@router.get("", **described(OwnerList, 422))
async def owners(service: ServiceDep, page: PageDep) -> Response:
    """List the owners by name."""
    rows = await service.store.owners(after=page.after, limit=page.limit + 1)
    found, following = page.cut(rows, lambda row: row.name_key)
    return reply(OwnerList(owners=tuple(owner_detail(row) for row in found), next=following))


@router.get("/{owner}", **described(OwnerDetail, 404), **WITHOUT_TOKEN_TOO)
async def owner(service: ServiceDep, authorization: AuthorizationDep, owner: str) -> Response:
    """Show one owner. One that the operator hides is shown to itself and the operator."""
    return reply(owner_detail(await service.registrations.shown_owner(owner, authorization)))


@router.post("/{owner}/token", **described(RegisteredOwner, 404, 507, status=201))
async def rotate(
    request: Request, service: ServiceDep, owner: str, authorization: AuthorizationDep, key: KeyDep
) -> Response:
    """Make a new token and show it once. The old one ends. For the owner itself or the operator."""
    # The key belongs to the old token, which no longer opens anything when the request is repeated.
    async with key.once(digest(bearer(authorization))) as once:
        row = await service.registrations.own(owner, authorization)
        found = owner_detail(row)
        token = new_token()
        remember = once.remember(201, Encoding.JSON, with_token=True)
        stored = remember(found.model_dump_json().encode()) if remember else None
        await service.registrations.set_owner_token(owner, token, stored)
        await service.administration.note(
            authorization, address_of(request), AuditAction.ROTATE, Collection.OWNERS, row
        )
    return reply(RegisteredOwner(**found.model_dump(), token=token), 201)


@router.delete("/{owner}/token", **described(None, 404, status=204))
async def revoke(request: Request, service: ServiceDep, owner: str, authorization: AuthorizationDep) -> Response:
    """End the owner's token. For the owner itself or the operator. Only the operator can make a new one then."""
    row = await service.registrations.own(owner, authorization)
    await service.registrations.set_owner_token(owner, None)
    await service.administration.note(authorization, address_of(request), AuditAction.REVOKE, Collection.OWNERS, row)
    return Response(status_code=204)
