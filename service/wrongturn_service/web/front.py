"""The leaderboards' pages."""

from typing import Final

from fastapi import APIRouter, Request, Response

from wrongturn_protocol import Leaderboard
from wrongturn_service import catalogue
from wrongturn_service.api.dependencies import ServiceDep
from wrongturn_service.service import Service
from wrongturn_service.web.page import page

router = APIRouter(include_in_schema=False)
FIRST: Final = "wrong-command@2"
"""The suite whose leaderboard is the first page."""


@router.api_route("/", methods=["GET", "HEAD"])
async def front(request: Request, service: ServiceDep) -> Response:
    """Show the leaderboard of the paper's suite."""
    return await _leaderboard(request, service, FIRST)


@router.api_route("/leaderboards/{suite}", methods=["GET", "HEAD"])
async def leaderboard(request: Request, service: ServiceDep, suite: str) -> Response:
    """Show the leaderboard of a suite."""
    return await _leaderboard(request, service, suite)


async def _leaderboard(request: Request, service: Service, suite_id: str) -> Response:
    suite = catalogue.suite(suite_id)
    board = Leaderboard.model_validate_json(await service.leaderboards.body(suite_id))
    return page(request, "leaderboard.html", suite=suite, board=board)
