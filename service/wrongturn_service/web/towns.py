"""The towns' pages."""

import asyncio
from functools import cache

from fastapi import APIRouter, Request, Response

from wrongturn_networks import load_suite, suite_ids
from wrongturn_networks.catalogue import list_towns
from wrongturn_protocol import Command, FaultKind, JunctionType
from wrongturn_service import catalogue
from wrongturn_service.web import town_map, words
from wrongturn_service.web.page import rendered, sent
from wrongturn_service.web.suites import towns_of

router = APIRouter(include_in_schema=False)


@router.api_route("/towns", methods=["GET", "HEAD"])
async def towns(request: Request) -> Response:
    """List the towns."""
    return sent(request, await asyncio.to_thread(_list))


@router.api_route("/towns/{town}", methods=["GET", "HEAD"])
async def town(request: Request, town: str) -> Response:
    """Show a town: its map and its approaches by type."""
    return sent(request, await asyncio.to_thread(_town, catalogue.town(town).name))


@cache
def _list() -> bytes:
    maps = {town.name: town_map.town_map(catalogue.town_detail(town.name)) for town in list_towns()}
    return rendered("towns.html", "/towns", towns=list_towns(), maps=maps, town_map=town_map, words=words)


@cache
def _town(name: str) -> bytes:
    """Return a town's page. Only names of towns come here, so few are kept."""
    detail = catalogue.town_detail(name)
    present = {approach.type for approach in detail.approaches}
    return rendered(
        "town.html",
        f"/towns/{name}",
        town=detail,
        map=town_map.town_map(detail),
        town_map=town_map,
        words=words,
        kinds=[kind for kind in JunctionType if kind in present],
        faults=[kind for kind in FaultKind if kind is not FaultKind.NONE],
        directions=[Command.LEFT, Command.STRAIGHT, Command.RIGHT],
        suites=[suite for suite in suite_ids() if name in towns_of(load_suite(suite))],
    )
