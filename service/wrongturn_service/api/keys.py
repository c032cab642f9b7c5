"""The public keys that sign certificates: for programs, and as a page."""

from fastapi import APIRouter, Request, Response

from wrongturn_protocol.certificates import KeyList, SigningKey
from wrongturn_service.api.admin import ActDep
from wrongturn_service.api.dependencies import ServiceDep, reply
from wrongturn_service.api.documents import Route, described
from wrongturn_service.web.page import page, public_url

router = APIRouter(tags=["keys"], route_class=Route)


@router.get("/v1/keys", **described(KeyList))
async def keys(service: ServiceDep) -> Response:
    """List the public keys that sign certificates, or have signed some: the current one first."""
    return reply(await service.certificates.keys())


@router.post("/v1/keys", **described(SigningKey, 422, status=201))
async def rotate(service: ServiceDep, act: ActDep) -> Response:
    """Sign certificates with a new key from now on; for the operator.

    The old key stays published, and its private part is deleted.
    """
    return reply(await service.certificates.rotate(act), 201)


@router.api_route("/keys", methods=["GET", "HEAD"], include_in_schema=False)
async def keys_page(request: Request, service: ServiceDep) -> Response:
    """Show the keys, and how a certificate is checked."""
    return page(request, "keys.html", keys=(await service.certificates.keys()).keys, url=public_url(request))
