"""The metrics: who may read them, and a port of their own."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Iterator
from typing import Final

import uvicorn
from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import Response
from starlette.routing import Route
from typing_extensions import override

from wrongturn_service.accounts import bearer
from wrongturn_service.client_address import parsed
from wrongturn_service.errors import StartupError, UnauthenticatedError
from wrongturn_service.settings import Settings
from wrongturn_service.telemetry import CONTENT_TYPE, Telemetry

_FORWARDED: Final = ("forwarded", "via", "x-forwarded-for", "x-forwarded-host", "x-forwarded-proto", "x-real-ip")
"""Headers with which a proxy passes on somebody else's request."""


def check_reader(settings: Settings, request: HTTPConnection) -> None:
    """Check that a request may read the metrics.

    It holds their token or the operator's. A service that has neither token shows them to programs of its own machine.

    Raises:
        UnauthenticatedError: It may not.
    """
    secrets = [secret for secret in (settings.metrics, settings.operator) if secret.required]
    if not secrets:
        if not _local(request):
            raise UnauthenticatedError(
                "the metrics of this service are for programs of its own machine; the operator can set "
                "WRONGTURN_METRICS_TOKEN, and the token then opens them from elsewhere"
            )
        return
    authorization = request.headers.get("authorization")
    if authorization is None:
        raise UnauthenticatedError("the metrics need a token: send 'Authorization: Bearer …' with the metrics' token")
    token = bearer(authorization)
    if not any(secret.is_(token) for secret in secrets):
        raise UnauthenticatedError("this is not the token of the metrics; ask the operator")


def _local(request: HTTPConnection) -> bool:
    """Return whether a program of this machine asks, and no proxy passed the request on."""
    if request.client is None or any(name in request.headers for name in _FORWARDED):
        return False
    address = parsed(request.client.host)
    return address is not None and address.is_loopback


@contextlib.asynccontextmanager
async def metrics_port(settings: Settings, telemetry: Telemetry) -> AsyncIterator[None]:
    """Serve the metrics on a port of their own while the block runs, if the settings name one.

    Raises:
        StartupError: The port cannot be listened on.
    """
    if settings.metrics_port is None:
        yield
        return
    bound = _bound(settings.host, settings.metrics_port)

    async def metrics(request: Request) -> Response:
        return _metrics(request, settings, telemetry)

    app = Starlette(routes=[Route("/metrics", metrics)])
    config = uvicorn.Config(app, lifespan="off", access_log=False, log_config=None, log_level="critical")
    server = SilentServer(config)
    serving = asyncio.create_task(server.serve(sockets=[bound]))
    try:
        yield
    finally:
        server.should_exit = True
        await serving
        bound.close()


class SilentServer(uvicorn.Server):
    """A server that leaves the process's signals alone."""

    @override
    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


def _metrics(request: Request, settings: Settings, telemetry: Telemetry) -> Response:
    try:
        check_reader(settings, request)
    except UnauthenticatedError as error:
        return Response(f"{error.detail}\n", error.status, headers=error.headers, media_type="text/plain")
    return Response(telemetry.render(), headers={"Content-Type": CONTENT_TYPE})


def _bound(host: str, port: int) -> socket.socket:
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        raise StartupError(
            f"metrics_port: {host}:{port} cannot be listened on ({error.strerror}); name another by "
            "WRONGTURN_METRICS_PORT"
        ) from error
