"""What is driven, and where: suites with their trials, and towns with their geometry."""

import asyncio
from collections.abc import Callable

from fastapi import APIRouter, Response
from pydantic import BaseModel

from wrongturn_networks.catalogue import list_suites, list_towns
from wrongturn_protocol import SuiteDetail, SuiteList, TownDetail, TownList, TrialList
from wrongturn_service import catalogue
from wrongturn_service.api.dependencies import ServiceDep
from wrongturn_service.api.documents import Route, described
from wrongturn_service.encoding import Encoding
from wrongturn_service.service import Service

suites_router = APIRouter(prefix="/v1/suites", tags=["suites"], route_class=Route)
towns_router = APIRouter(prefix="/v1/towns", tags=["towns"], route_class=Route)


@suites_router.get("", **described(SuiteList))
async def suites(service: ServiceDep) -> Response:
    """List all suites."""
    return await _made_once(service, "suites", lambda: SuiteList(suites=tuple(list_suites())))


@suites_router.get("/{suite}", **described(SuiteDetail, 404))
async def suite(service: ServiceDep, suite: str) -> Response:
    """Show one suite, such as ``wrong-command@3``, and the cells from which each evaluation draws its trials."""
    return await _made_once(service, f"suite {suite}", lambda: catalogue.suite(suite).detail())


@suites_router.get("/{suite}/trials", **described(TrialList, 404))
async def trials(service: ServiceDep, suite: str) -> Response:
    """List the suite's trials for practice. Each names its twin, which can be practised too.

    If every evaluation draws its own trials, these are those of the open draw, and ``draw`` says so. While the towns of
    the open draw are built, you get 503 ``towns-not-built``.
    """
    found = catalogue.suite(suite)
    draw = service.draws.open_draw(found)
    return await _made_once(service, f"trials {suite}", lambda: found.trial_list(draw))


@towns_router.get("", **described(TownList))
async def towns(service: ServiceDep) -> Response:
    """List all towns."""
    return await _made_once(service, "towns", lambda: TownList(towns=tuple(list_towns())))


@towns_router.get("/{town}", **described(TownDetail, 404))
async def town(service: ServiceDep, town: str) -> Response:
    """Show one town with its approaches and geometry."""
    return await _made_once(service, f"town {town}", lambda: catalogue.town_detail(town))


async def _made_once(service: Service, name: str, make: Callable[[], BaseModel]) -> Response:
    """Return a response with a message that never changes, which its name decides. It is made once, in a thread."""
    body = await service.documents.get(name, lambda: asyncio.to_thread(lambda: make().model_dump_json().encode()))
    return Response(body, media_type=Encoding.JSON)
