"""Around every request: its time, the short way of a step, and the last resort for exceptions nobody expected."""

import time
from collections.abc import Awaitable, Callable

import structlog
from fastapi import Request, Response
from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from wrongturn_service import logs
from wrongturn_service.api.errors import as_service_error, problem_response
from wrongturn_service.telemetry import Telemetry

_PREFIX = "/v1/episodes/"
_SUFFIX = "/step"
_QUIET = {"/health/live", "/health/ready", "/metrics"}
_STEP_ROUTE = f"{_PREFIX}{{episode}}{_SUFFIX}"


class Middleware:
    """Plain ASGI: it costs a step no more than two clock readings and an id, and spares it the routing.

    Of all requests nearly all are steps, and matching one against every route took longer than the rest of its
    handling; so they go straight to the function that their route names too.
    """

    def __init__(
        self,
        app: ASGIApp,
        telemetry: Telemetry,
        step: Callable[[Request, str], Awaitable[Response]],
    ) -> None:
        self._app = app
        self._telemetry = telemetry
        self._step = step
        self._log = structlog.get_logger("requests")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began = time.perf_counter()
        episode = _stepped_episode(scope)
        request_id = logs.begin_request(scope["path"])
        if episode is not None:
            try:
                response = await self._step(Request(scope, receive), episode)
            except Exception as error:
                response = problem_response(as_service_error(error))
            await response(scope, receive, send)
            self._telemetry.answered("POST", _STEP_ROUTE, response.status_code, time.perf_counter() - began)
            return
        status = 0

        async def watched(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                MutableHeaders(scope=message)["X-Request-Id"] = request_id
            await send(message)

        try:
            await self._app(scope, receive, watched)
        except Exception as error:
            if status:
                raise
            await problem_response(as_service_error(error))(scope, receive, watched)
        finally:
            # The route's pattern, never the path: ids would make a series each.
            route = getattr(scope.get("route"), "path", "unknown")
            seconds = time.perf_counter() - began
            self._telemetry.answered(scope["method"], route, status, seconds)
            # What is asked for again and again by machines would drown the rest.
            log = self._log.debug if route in _QUIET else self._log.info
            log("request", method=scope["method"], route=route, status=status, seconds=round(seconds, 6))


def _stepped_episode(scope: Scope) -> str | None:
    path: str = scope["path"]
    if scope["method"] != "POST" or not path.startswith(_PREFIX) or not path.endswith(_SUFFIX):
        return None
    episode = path[len(_PREFIX) : -len(_SUFFIX)]
    return episode if episode and "/" not in episode else None
