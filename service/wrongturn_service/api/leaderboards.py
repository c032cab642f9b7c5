"""Public rankings."""

from typing import Annotated

from fastapi import APIRouter, Query, Response

from wrongturn_protocol import Comparison, Leaderboard, LeaderboardList
from wrongturn_service.api.dependencies import ServiceDep, reply
from wrongturn_service.api.documents import Route, described
from wrongturn_service.encoding import Encoding

router = APIRouter(prefix="/v1/leaderboards", tags=["leaderboards"], route_class=Route)


@router.get("", **described(LeaderboardList))
async def leaderboards(service: ServiceDep) -> Response:
    """List the leaderboards."""
    return reply(await service.leaderboards.summaries())


@router.get("/{suite}", **described(Leaderboard, 404))
async def leaderboard(service: ServiceDep, suite: str) -> Response:
    """Show the ranking on a suite. The first evaluation that an agent finishes counts."""
    return Response(await service.leaderboards.body(suite), media_type=Encoding.JSON)


@router.get("/{suite}/compare", **described(Comparison, 404, 422))
async def compare(
    service: ServiceDep,
    suite: str,
    a: Annotated[str, Query(description="Id or name of an agent.")],
    b: Annotated[str, Query(description="Id or name of another agent.")],
) -> Response:
    """Compare two agents in the strict column, by an exact test within junction types and faults."""
    return reply(await service.leaderboards.compare(suite, a, b))
