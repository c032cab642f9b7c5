"""Towns: junctions and approaches by type, and geometry for drawing."""

from fastapi import APIRouter, Response

from wrongturn_networks.catalogue import list_towns
from wrongturn_protocol import TownDetail, TownList
from wrongturn_service import catalogue
from wrongturn_service.api.dependencies import ServiceDep, made_once
from wrongturn_service.api.documents import Route, described

router = APIRouter(prefix="/v1/towns", tags=["towns"], route_class=Route)


@router.get("", **described(TownList))
async def towns(service: ServiceDep) -> Response:
    """List all towns."""
    return await made_once(service, "towns", lambda: TownList(towns=tuple(list_towns())))


@router.get("/{town}", **described(TownDetail, 404))
async def town(service: ServiceDep, town: str) -> Response:
    """Show one town with its approaches and geometry."""
    return await made_once(service, f"town {town}", lambda: catalogue.town_detail(town))
