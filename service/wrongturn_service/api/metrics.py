"""The metrics: who may read them, and a port of their own."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Final

import uvicorn
from fastapi import APIRouter, FastAPI, Request, Response

from wrongturn_protocol import ProblemType
from wrongturn_service.accounts import bearer
from wrongturn_service.address import AddressError, bind
from wrongturn_service.api.dependencies import ServiceDep
from wrongturn_service.api.documents import Route, described
from wrongturn_service.api.errors import response_for
from wrongturn_service.client_address import parsed
from wrongturn_service.errors import NotFoundError, StartupError, UnauthenticatedError
from wrongturn_service.settings import Settings
from wrongturn_service.telemetry import CONTENT_TYPE, Telemetry

router = APIRouter(tags=["health"], route_class=Route)
_FORWARDED: Final = ("forwarded", "via", "x-forwarded-for", "x-forwarded-host", "x-forwarded-proto", "x-real-ip")
"""Headers with which a proxy passes on somebody else's request."""


@router.get("/metrics", **described(None, 401, media="text/plain"))
async def metrics(request: Request, service: ServiceDep) -> Response:
    """Return Prometheus metrics. Needs the metrics token or the operator's.

    A service without either token shows them to programs of its own machine.
    """
    if service.settings.metrics_port is not None:
        raise NotFoundError(ProblemType.UNKNOWN_ROUTE, "the metrics of this service have a port of their own")
    return _shown(request, service.settings, service.telemetry)


@contextlib.asynccontextmanager
async def own_port(settings: Settings, telemetry: Telemetry) -> AsyncIterator[None]:
    """Serve the metrics on a port of their own while the block runs, if the settings name one.

    Raises:
        StartupError: The port cannot be listened on.
    """
    if settings.metrics_port is None:
        yield
        return
    try:
        bound = bind(settings.host, settings.metrics_port)
    except AddressError as error:
        named = f"WRONGTURN_METRICS_PORT: {settings.metrics_port}"
        raise StartupError(f"{named}: {error.reason}; name another port") from error

    async def show(request: Request) -> Response:
        try:
            return _shown(request, settings, telemetry)
        except UnauthenticatedError as error:
            return response_for(request, error)

    app = FastAPI(openapi_url=None)
    app.add_route("/metrics", show)
    server = uvicorn.Server(
        uvicorn.Config(app, lifespan="off", access_log=False, log_config=None, log_level="critical")
    )
    # The process's signals are the main server's.
    server.capture_signals = contextlib.nullcontext  # type: ignore[assignment, method-assign]
    serving = asyncio.create_task(server.serve([bound]))
    try:
        yield
    finally:
        server.should_exit = True
        await serving


def _shown(request: Request, settings: Settings, telemetry: Telemetry) -> Response:
    _check_reader(settings, request)
    return Response(telemetry.render(), headers={"Content-Type": CONTENT_TYPE})


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
