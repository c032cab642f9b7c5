"""Health, readiness and metrics."""

import asyncio
from typing import Final

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel
from sqlalchemy.exc import SQLAlchemyError

from wrongturn_protocol import ProblemType
from wrongturn_service.api.dependencies import ServiceDep, reply
from wrongturn_service.api.documents import Route, described
from wrongturn_service.errors import NotFoundError, UnavailableError
from wrongturn_service.metrics_port import check_reader
from wrongturn_service.readiness import why_not_ready
from wrongturn_service.telemetry import CONTENT_TYPE

router = APIRouter(tags=["health"], route_class=Route)
_PATIENCE_S: Final = 3.0


class Health(BaseModel):
    """The reply of a healthy service."""

    status: str = "ok"


class Readiness(Health):
    """The reply of a service in which new episodes can begin."""

    submissions: str
    """Whether models can be handed in: ``on`` and by what they are driven, or ``off`` and why."""
    simulators: int
    """Largest number of episodes that are driven at a time."""


@router.get("/health/live", **described(Health))
async def live() -> Response:
    """Tell that the process answers."""
    return reply(Health())


@router.get("/health/ready", **described(Readiness))
async def ready(service: ServiceDep) -> Response:
    """Tell whether new episodes can begin.

    They can if the database answers and its last write succeeded, a simulator runs or could be started, and the
    service is not stopping.
    """
    error = why_not_ready(service.episodes, service.pool, service.store)
    if error is not None:
        raise error
    try:
        await asyncio.wait_for(service.store.ping(), _PATIENCE_S)
    except TimeoutError:
        raise UnavailableError(
            ProblemType.STORAGE_FAILED, f"the database did not answer within {_PATIENCE_S:g} s", retry_after_s=5
        ) from None
    except SQLAlchemyError:
        # Whoever is the first to notice hears the same as the next.
        error = why_not_ready(service.episodes, service.pool, service.store)
        if error is None:
            raise
        raise error from None
    return reply(Readiness(submissions=str(service.availability), simulators=service.pool.slots))


@router.get("/metrics", **described(None, 401, 404, media="text/plain"))
async def metrics(request: Request, service: ServiceDep) -> Response:
    """Show metrics for Prometheus, to who has their token or the operator's.

    A service without either token shows them to programs of its own machine. They can have a port of their own.
    """
    if service.settings.metrics_port is not None:
        raise NotFoundError(ProblemType.UNKNOWN_ROUTE, "the metrics of this service are on a port of their own")
    check_reader(service.settings, request)
    return Response(service.telemetry.render(), headers={"Content-Type": CONTENT_TYPE})
