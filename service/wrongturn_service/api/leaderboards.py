"""Public rankings."""

import asyncio
from typing import Annotated, Final

from fastapi import APIRouter, Query, Request, Response

from wrongturn_protocol import Comparison, Leaderboard, LeaderboardList
from wrongturn_protocol.standing_rows import leaderboard_csv
from wrongturn_service.api.dependencies import ServiceDep, reply, weights
from wrongturn_service.api.documents import Route, described
from wrongturn_service.encoding import Encoding
from wrongturn_service.service import Service

router = APIRouter(prefix="/v1/leaderboards", tags=["leaderboards"], route_class=Route)


@router.get("", **described(LeaderboardList))
async def leaderboards(service: ServiceDep) -> Response:
    """List the leaderboards."""
    return reply(await service.leaderboards.summaries())


_CSV: Final = "text/csv"
_SHOWN = described(Leaderboard, 404)
_SHOWN["responses"][200]["content"] = {Encoding.JSON.value: {}, _CSV: {"schema": {"type": "string"}}}


async def csv_of(service: Service, suite: str) -> str:
    """Return a leaderboard as CSV, a row for each agent. Raises NotFoundError."""
    board = await service.leaderboards.board(suite)
    key = ("csv", service.leaderboards.generation, suite)
    rows: str = await service.cache.get(key, lambda: asyncio.to_thread(leaderboard_csv, board))
    return rows


@router.get("/{suite}", **_SHOWN)
async def leaderboard(service: ServiceDep, request: Request, suite: str) -> Response:
    """Show the ranking on a suite. The first evaluation that an agent finishes counts.

    ``Accept: text/csv`` gets a row for each agent.
    """
    varies = {"Vary": "Accept"}
    wanted = dict(weights(request.headers.get("accept", "")))
    if wanted.get(_CSV, 0.0) > wanted.get(Encoding.JSON, 0.0):
        return Response(await csv_of(service, suite), media_type=_CSV, headers=varies)
    return Response(await service.leaderboards.body(suite), media_type=Encoding.JSON, headers=varies)


@router.get("/{suite}/compare", **described(Comparison, 404, 422))
async def compare(
    service: ServiceDep,
    suite: str,
    a: Annotated[str, Query(description="Id or name of an agent.")],
    b: Annotated[str, Query(description="Id or name of another agent.")],
) -> Response:
    """Compare two agents in the strict column, by an exact test within junction types and faults."""
    key = ("comparison", service.leaderboards.generation, suite, a, b)
    return reply(await service.cache.get(key, lambda: service.leaderboards.compare(suite, a, b)))
