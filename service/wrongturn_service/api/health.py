"""Health, readiness and metrics."""

import asyncio
from typing import Final

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel
from sqlalchemy.exc import SQLAlchemyError

from wrongturn_protocol import ProblemType
from wrongturn_service.accounts import bearer
from wrongturn_service.api.dependencies import ServiceDep, reply
from wrongturn_service.api.documents import Route, described
from wrongturn_service.client_address import parsed
from wrongturn_service.errors import UnauthenticatedError, UnavailableError
from wrongturn_service.settings import Settings
from wrongturn_service.telemetry import CONTENT_TYPE

router = APIRouter(tags=["health"], route_class=Route)
_PATIENCE_S: Final = 3.0
_FORWARDED: Final = ("forwarded", "via", "x-forwarded-for", "x-forwarded-host", "x-forwarded-proto", "x-real-ip")
"""Headers with which a proxy passes on somebody else's request."""


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


@router.get("/metrics", **described(None, 401, media="text/plain"))
async def metrics(request: Request, service: ServiceDep) -> Response:
    """Return Prometheus metrics. Needs the metrics token or the operator's.

    A service without either token shows them to programs of its own machine.
    """
    _check_reader(service.settings, request)
    return Response(service.telemetry.render(), headers={"Content-Type": CONTENT_TYPE})


def _check_reader(settings: Settings, request: Request) -> None:
    """Check that a request may read the metrics. Raises UnauthenticatedError."""
    secrets = [secret for secret in (settings.metrics, settings.operator) if secret.required]
    authorization = request.headers.get("authorization")
    if not secrets and not _local(request):
        raise UnauthenticatedError(
            "the metrics of this service are for programs of its own machine; the operator can set "
            "WRONGTURN_METRICS_TOKEN, and the token then opens them from elsewhere"
        )
    if secrets and authorization is None:
        raise UnauthenticatedError("the metrics need a token: send 'Authorization: Bearer …' with the metrics' token")
    if secrets and not any(secret.is_(bearer(authorization)) for secret in secrets):
        raise UnauthenticatedError("this is not the token of the metrics; ask the operator")


def _local(request: Request) -> bool:
    """Return whether a program of this machine asks, and no proxy passed the request on."""
    if request.client is None or any(name in request.headers for name in _FORWARDED):
        return False
    address = parsed(request.client.host)
    return address is not None and address.is_loopback
