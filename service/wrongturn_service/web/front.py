"""The leaderboards' pages, with figures that packages name by entry points in the group ``wrongturn.figures``."""

import asyncio
from collections.abc import Iterator, Sequence
from enum import StrEnum
from importlib import metadata
from typing import Annotated, Any, Final, TypeVar

import structlog
from fastapi import APIRouter, Query, Request, Response
from markupsafe import Markup
from starlette.responses import PlainTextResponse

from wrongturn_networks import Suite, load_suite
from wrongturn_protocol import AgentKind, Leaderboard, LeaderboardEntry, LeaderboardSummary, Track
from wrongturn_protocol.standing_rows import MARKS
from wrongturn_service import catalogue
from wrongturn_service.api.dependencies import ServiceDep
from wrongturn_service.api.leaderboards import csv_of
from wrongturn_service.errors import InvalidRequestError
from wrongturn_service.service import Service
from wrongturn_service.web import junction_map, words
from wrongturn_service.web.failed import failed_trial
from wrongturn_service.web.page import SECURITY, numbered_page, rendered, sent
from wrongturn_service.web.standings import of_paper, page_count, standings

router = APIRouter(include_in_schema=False)
FIRST: Final = "wrong-command-unseen@1"
"""The suite whose leaderboard is the first page: the ranking that counts."""
_PAPERS: Final = "wrong-command@3"
"""The suite of the paper's table."""
_SHOWN: Final = (FIRST, _PAPERS, "smoke@3")
"""Suites of which the first page shows a failed trial."""
Filter = Annotated[str, Query(max_length=40)]
_KINDS: Final = (AgentKind.SUBMITTED, AgentKind.REFERENCE, AgentKind.BASELINE, AgentKind.EXPLOIT, AgentKind.ALGORITHM)
"""Kinds in the order of the filter."""
_GROUP: Final = "wrongturn.figures"
"""Entry points of functions that get the entries, and return a figure as HTML, such as SVG; None if there is none."""
_Word = TypeVar("_Word", bound=StrEnum)


@router.api_route("/", methods=["GET", "HEAD"])
async def front(
    request: Request, service: ServiceDep, track: Filter = "", kind: Filter = "", page: Filter = "1"
) -> Response:
    """Show the leaderboard that counts."""
    return await _leaderboard(request, service, FIRST, track, kind, page)


@router.api_route("/leaderboards/{suite}", methods=["GET", "HEAD"])
async def leaderboard(
    request: Request, service: ServiceDep, suite: str, track: Filter = "", kind: Filter = "", page: Filter = "1"
) -> Response:
    """Show the leaderboard of a suite."""
    return await _leaderboard(request, service, suite, track, kind, page)


@router.api_route("/leaderboards/{suite}/table.csv", methods=["GET", "HEAD"])
async def table(service: ServiceDep, suite: str) -> Response:
    """Send a leaderboard as CSV, a row for each agent."""
    return PlainTextResponse(await csv_of(service, suite), media_type="text/csv", headers=SECURITY)


async def _leaderboard(
    request: Request, service: Service, suite_id: str, track_name: str, kind_name: str, page_number: str
) -> Response:
    suite = catalogue.suite(suite_id)
    track = _word("query.track", track_name, Track)
    kind = _word("query.kind", kind_name, AgentKind)
    generation = service.leaderboards.generation
    # A board is made once for all filters; so a wrong page's number is found before anything is rendered.
    board = await service.leaderboards.board(suite_id)
    entries = [
        entry
        for entry in board.entries
        if (track is None or entry.agent.track is track) and (kind is None or entry.agent.kind is kind)
    ]
    number = numbered_page(page_number, page_count(entries))

    async def render() -> bytes:
        others = await service.leaderboards.summaries()
        front = request.url.path == "/"
        failed = await failed_trial(service, _SHOWN) if front else None
        values = {"front": front, "failed": failed, "others": sorted(others.leaderboards, key=_place)}
        return await asyncio.to_thread(_render, request.url.path, suite, board, entries, track, kind, number, values)

    return sent(request, await service.pages.get((generation, request.url.path, suite_id, track, kind, number), render))


def _render(
    path: str,
    suite: Suite,
    board: Leaderboard,
    entries: Sequence[LeaderboardEntry],
    track: Track | None,
    kind: AgentKind | None,
    number: int,
    values: dict[str, Any],
) -> bytes:
    journeys = suite.of_journeys
    return rendered(
        "leaderboard.html",
        path,
        suite=suite,
        board=board,
        journeys=journeys,
        table=standings(board, entries, number, journeys=journeys, paper=kind is None),
        figures=list(_figures(entries)),
        words=words,
        marks=MARKS,
        track=track,
        kind=kind,
        tracks=[each for each in Track if each in suite.tracks],
        kinds=_KINDS,
        papers=_PAPERS if suite.id == FIRST else None,
        box=junction_map,
        **values,
    )


def _place(board: LeaderboardSummary) -> tuple[bool, bool, bool, bool, str]:
    """Return what orders the list of leaderboards: the first one, unseen towns, the paper's suites, then others."""
    suite = load_suite(board.suite)
    return board.suite != FIRST, not suite.makes_towns, not of_paper(board.suite), suite.of_journeys, board.suite


def _word(path: str, name: str, words: type[_Word]) -> _Word | None:
    """Return the word that a filter names; None for an empty filter. Raises InvalidRequestError."""
    if not name:
        return None
    try:
        return words(name)
    except ValueError as error:
        message = f"{name!r} is none of {', '.join(words)}; leave it out to see all"
        raise InvalidRequestError(path, message) from error


def _figures(entries: Sequence[LeaderboardEntry]) -> Iterator[tuple[str, Markup]]:
    """Yield the figures of a leaderboard's entries by their entry points' names. One that fails is logged."""
    for point in sorted(metadata.entry_points(group=_GROUP), key=lambda point: point.name):
        try:
            drawn: str | None = point.load()(entries)
        except Exception:
            structlog.get_logger("pages").exception("figure failed", plugin=point.value)
            continue
        if drawn:
            yield point.name, Markup(drawn)  # noqa: S704 -- the operator has installed the package
