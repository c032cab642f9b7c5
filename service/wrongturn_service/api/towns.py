"""Towns: junctions and approaches by type, and geometry for drawing."""

import asyncio

from fastapi import APIRouter, Response

from wrongturn_networks.catalogue import list_towns
from wrongturn_protocol import TownDetail, TownList
from wrongturn_service import catalogue
from wrongturn_service.api.dependencies import reply
from wrongturn_service.api.documents import Route, described

router = APIRouter(prefix="/v1/towns", tags=["towns"], route_class=Route)


@router.get("", **described(TownList))
async def towns() -> Response:
    """List all towns."""
    return reply(TownList(towns=tuple(list_towns())))


@router.get("/{town}", **described(TownDetail, 404))
async def town(town: str) -> Response:
    """Show one town with its approaches and geometry."""
    return reply(await asyncio.to_thread(catalogue.town_detail, town))
