"""Health and readiness."""

import asyncio
from typing import Final

from fastapi import APIRouter, Response
from pydantic import BaseModel
from sqlalchemy.exc import SQLAlchemyError

from wrongturn_protocol import ProblemType
from wrongturn_service.api.dependencies import ServiceDep, reply
from wrongturn_service.api.documents import Route, described
from wrongturn_service.errors import UnavailableError

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
    error = service.why_not_ready()
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
        error = service.why_not_ready()
        if error is None:
            raise
        raise error from None
    return reply(Readiness(submissions=str(service.availability), simulators=service.pool.slots))
