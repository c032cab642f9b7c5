"""Whether the service lives, whether it can work, and its figures."""

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel

from wrongturn_protocol import ProblemType
from wrongturn_service.api.dependencies import reply, service_of
from wrongturn_service.api.documents import described
from wrongturn_service.errors import UnavailableError
from wrongturn_service.telemetry import CONTENT_TYPE

router = APIRouter(tags=["health"])


class Health(BaseModel):
    """All is well."""

    status: str = "ok"


@router.get("/health/live", **described(Health))
async def live() -> Response:
    """Whether the process answers."""
    return reply(Health())


@router.get("/health/ready", **described(Health))
async def ready(request: Request) -> Response:
    """Whether new episodes can be had: the database answers, and the service is not about to end."""
    service = service_of(request)
    if service.episodes.stopping:
        raise UnavailableError(ProblemType.SHUTTING_DOWN, "the service is stopping")
    await service.store.ping()
    return reply(Health())


@router.get("/metrics", **described(None, media="text/plain"))
async def metrics(request: Request) -> Response:
    """Figures for Prometheus."""
    return Response(service_of(request).telemetry.render(), headers={"Content-Type": CONTENT_TYPE})
