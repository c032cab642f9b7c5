"""Whether the service lives, whether it can work, and its figures."""

import asyncio
from typing import Final

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel

from wrongturn_protocol import ProblemType
from wrongturn_service.api.dependencies import reply, service_of
from wrongturn_service.api.documents import described
from wrongturn_service.errors import UnavailableError
from wrongturn_service.telemetry import CONTENT_TYPE

router = APIRouter(tags=["health"])
_PATIENCE_S: Final = 3.0


class Health(BaseModel):
    """All is well."""

    status: str = "ok"


@router.get("/health/live", **described(Health))
async def live() -> Response:
    """Whether the process answers."""
    return reply(Health())


@router.get("/health/ready", **described(Health))
async def ready(request: Request) -> Response:
    """Whether new episodes can be had.

    The database answers and is this service's, a simulator is there or could be started (the first of them compiled
    what all need before the service began to answer), and the service is not about to end.
    """
    service = service_of(request)
    if service.episodes.stopping:
        raise UnavailableError(ProblemType.SHUTTING_DOWN, "the service is stopping")
    if service.pool.failure is not None and not service.pool.running:
        raise UnavailableError(ProblemType.SIMULATOR_FAILED, "no simulator could be started", retry_after_s=30)
    try:
        await asyncio.wait_for(service.store.ping(), _PATIENCE_S)
    except TimeoutError:
        raise UnavailableError(
            ProblemType.STORAGE_FAILED, f"the database did not answer within {_PATIENCE_S:g} s", retry_after_s=5
        ) from None
    return reply(Health())


@router.get("/metrics", **described(None, media="text/plain"))
async def metrics(request: Request) -> Response:
    """Figures for Prometheus."""
    return Response(service_of(request).telemetry.render(), headers={"Content-Type": CONTENT_TYPE})
