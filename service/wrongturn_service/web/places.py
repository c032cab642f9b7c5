"""The pages of suites and towns, and the page that says how to hand in an agent."""

import asyncio
from collections import Counter
from collections.abc import Iterable
from functools import cache
from typing import Annotated, Final, NamedTuple

from fastapi import APIRouter, Query, Request, Response

from wrongturn_networks import Suite, load_suite, suite_ids
from wrongturn_networks.catalogue import list_suites, list_towns
from wrongturn_networks.draws import is_drawn_cell
from wrongturn_protocol import Cell, Command, Condition, Fault, FaultKind, JunctionType, Task, Track, Trial
from wrongturn_protocol.observations import observation_space
from wrongturn_service import catalogue
from wrongturn_service.api.dependencies import ServiceDep
from wrongturn_service.settings import Registration
from wrongturn_service.web import town_map, words
from wrongturn_service.web.front import FIRST
from wrongturn_service.web.page import page, public_url, rendered, sent

router = APIRouter(include_in_schema=False)


class Stratum(NamedTuple):
    """Trials that are alike, and how many there are."""

    town: str
    what: JunctionType | Task
    """Type of the junctions; the task of journeys."""
    how: Fault | Condition
    """The fault; the condition of journeys."""
    weather: str
    traffic: str
    trials: int


@router.api_route("/suites", methods=["GET", "HEAD"])
async def suites(request: Request) -> Response:
    """List the suites."""
    return sent(request, await asyncio.to_thread(_suites))


@router.api_route("/suites/{suite}", methods=["GET", "HEAD"])
async def suite(request: Request, suite: str) -> Response:
    """Show what is in a suite."""
    return sent(request, await asyncio.to_thread(_suite, catalogue.suite(suite).id))


@router.api_route("/towns", methods=["GET", "HEAD"])
async def towns(request: Request) -> Response:
    """List the towns."""
    return sent(request, await asyncio.to_thread(_towns))


@router.api_route("/towns/{town}", methods=["GET", "HEAD"])
async def town(request: Request, town: str) -> Response:
    """Show a town: its map and its approaches by type."""
    return sent(request, await asyncio.to_thread(_town, catalogue.town(town).name))


@router.api_route("/submit", methods=["GET", "HEAD"])
async def submit(
    request: Request, service: ServiceDep, suite: Annotated[str, Query(max_length=80)] = FIRST
) -> Response:
    """Show how to hand in an agent, with commands that carry this service's address."""
    settings = service.settings
    return page(
        request,
        "submit.html",
        url=public_url(request),
        submissions=settings.submissions > 0,
        registration=settings.registration is Registration.OPEN,
        limit_mib=settings.model_limit // 2**20,
        suite=catalogue.suite(suite).summary(),
        suites=list_suites(),
        inputs=_inputs(),
    )


@cache
def _inputs() -> list[dict[str, str]]:
    """Return what a model may take: each key of the observations, with its shape, dtype and tracks."""
    found: dict[str, tuple[str, str, list[str]]] = {}
    for track in Track:
        for name, space in observation_space(track).items():
            assert space.shape is not None
            shape = " by ".join(["N", *map(str, space.shape)])
            found.setdefault(name, (shape, str(space.dtype), []))[2].append(track)
    return [
        {"name": name, "shape": shape, "dtype": dtype, "tracks": _in_words(tracks)}
        for name, (shape, dtype, tracks) in found.items()
    ]


def _in_words(tracks: list[str]) -> str:
    return "every track" if tracks == [*Track] else f"{' and '.join(tracks)} track{'s' if tracks[1:] else ''}"


DRAWN: Final = "of its own"
"""What stands for the towns that each evaluation has of its own."""


def strata(items: Iterable[Cell | Trial]) -> list[Stratum]:
    """Count what is alike, in the order of the suite."""
    alike: Counter[tuple[str, JunctionType | Task, Fault | Condition, str, str]] = Counter()
    for item in items:
        traffic = item.traffic
        others = f"{traffic.vehicles} cars, {traffic.pedestrians} pedestrians" if traffic.vehicles else "none"
        task = item.task if isinstance(item, Cell) else item.journey and item.journey.task
        what = task or item.junction_type
        assert what is not None
        how = item.fault if task is None else Condition.of(item.town, item.weather)
        town = DRAWN if isinstance(item, Cell) and is_drawn_cell(item) else item.town
        alike[town, what, how, item.weather.value, others] += 1
    return [Stratum(*key, count) for key, count in alike.items()]


def _towns_of(suite: Suite) -> list[str]:
    drawn = {cell.town for cell in suite.cells if is_drawn_cell(cell)}
    return sorted({item.town for item in suite.cells or suite.listed} - drawn)


# Pages that never change. Only ids of suites and names of towns come here, so few are kept.


@cache
def _suites() -> bytes:
    return rendered("suites.html", "/suites", suites=list_suites())


@cache
def _suite(suite_id: str) -> bytes:
    found = catalogue.suite(suite_id)
    return rendered(
        "suite.html",
        f"/suites/{suite_id}",
        suite=found.summary(),
        drawn=bool(found.cells),
        makes_towns=found.makes_towns,
        own_towns=DRAWN,
        journeys=found.of_journeys,
        strata=strata(found.cells or found.listed),
        towns=_towns_of(found),
        town_map=town_map,
        words=words,
    )


@cache
def _towns() -> bytes:
    maps = {town.name: town_map.town_map(catalogue.town_detail(town.name)) for town in list_towns()}
    return rendered("towns.html", "/towns", towns=list_towns(), maps=maps, town_map=town_map, words=words)


@cache
def _town(name: str) -> bytes:
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
        suites=[suite for suite in suite_ids() if name in _towns_of(load_suite(suite))],
    )
