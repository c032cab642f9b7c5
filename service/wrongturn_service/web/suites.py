"""The suites' pages."""

import asyncio
from collections import Counter
from collections.abc import Iterable
from functools import cache
from typing import NamedTuple

from fastapi import APIRouter, Request, Response

from wrongturn_judge.metrics import of_journeys
from wrongturn_networks import Suite
from wrongturn_networks.catalogue import list_suites
from wrongturn_protocol import Cell, Condition, FaultKind, JunctionType, Task, Trial
from wrongturn_service import catalogue
from wrongturn_service.web import town_map, words
from wrongturn_service.web.page import rendered, sent

router = APIRouter(include_in_schema=False)


class Stratum(NamedTuple):
    """Trials that are alike, and how many there are."""

    town: str
    what: JunctionType | Task
    """Type of the junctions; the task of journeys."""
    how: FaultKind | Condition
    """The fault; the condition of journeys."""
    weather: str
    traffic: str
    trials: int


@router.api_route("/suites", methods=["GET", "HEAD"])
async def suites(request: Request) -> Response:
    """List the suites."""
    return sent(request, await asyncio.to_thread(_list))


@router.api_route("/suites/{suite}", methods=["GET", "HEAD"])
async def suite(request: Request, suite: str) -> Response:
    """Show what is in a suite."""
    return sent(request, await asyncio.to_thread(_suite, catalogue.suite(suite).id))


def towns_of(suite: Suite) -> tuple[str, ...]:
    """Return the names of a suite's towns."""
    return tuple(sorted({item.town for item in suite.cells or suite.listed}))


def strata(items: Iterable[Cell | Trial]) -> list[Stratum]:
    """Count what is alike, in the order of the suite."""
    alike: Counter[tuple[str, JunctionType | Task, FaultKind | Condition, str, str]] = Counter()
    for item in items:
        traffic = item.traffic
        others = f"{traffic.vehicles} cars, {traffic.pedestrians} pedestrians" if traffic.vehicles else "none"
        journey = item.journey if isinstance(item, Trial) else None
        what = item.junction_type if journey is None else journey.task
        how = item.fault.kind if journey is None else Condition.of(item.town, item.weather)
        alike[item.town, what, how, item.weather.value, others] += 1
    return [Stratum(*key, count) for key, count in alike.items()]


@cache
def _list() -> bytes:
    return rendered("suites.html", "/suites", suites=list_suites())


@cache
def _suite(suite_id: str) -> bytes:
    """Return a suite's page. Only ids of suites come here, so few are kept."""
    found = catalogue.suite(suite_id)
    return rendered(
        "suite.html",
        f"/suites/{suite_id}",
        suite=found.summary(),
        drawn=bool(found.cells),
        journeys=of_journeys(found.open_draw),
        strata=strata(found.cells or found.listed),
        towns=towns_of(found),
        town_map=town_map,
        words=words,
    )
