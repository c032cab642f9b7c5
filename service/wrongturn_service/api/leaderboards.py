"""The rankings, for everybody."""

from fastapi import APIRouter, Request, Response

from wrongturn_protocol import Leaderboard, LeaderboardList
from wrongturn_service.api.dependencies import reply, service_of
from wrongturn_service.api.documents import described
from wrongturn_service.encoding import Encoding

router = APIRouter(prefix="/v1/leaderboards", tags=["leaderboards"])


@router.get("", **described(LeaderboardList))
async def leaderboards(request: Request) -> Response:
    """All leaderboards, in short."""
    return reply(await service_of(request).leaderboards.summaries())


@router.get("/{suite}", **described(Leaderboard, 404))
async def leaderboard(request: Request, suite: str) -> Response:
    """The ranking on a suite: each agent's first finished evaluation counts."""
    return Response(await service_of(request).leaderboards.body(suite), media_type=Encoding.JSON)
