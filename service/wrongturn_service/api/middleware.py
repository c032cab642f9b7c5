"""Middleware around every request: its id, its time, its log line, and a reply to errors that nobody expected."""

import re
import time
from collections.abc import Awaitable, Callable
from typing import Final

import structlog
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from wrongturn_protocol import ProblemType
from wrongturn_service import logs
from wrongturn_service.api.errors import as_service_error, response_for
from wrongturn_service.errors import InvalidRequestError, NotFoundError
from wrongturn_service.telemetry import Telemetry

_QUIET: Final = {"/health/live", "/health/ready", "/metrics"}
"""Routes that are logged at level debug, since programs call them again and again."""
_METHODS: Final = {"GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS", "PATCH"}
"""Methods that have metrics of their own. HTTP's parser knows forty."""
_QUOTA_REACHED: Final = 507
_STEP: Final = "/v1/episodes/{episode}/step"
"""Not logged at all: a line costs a tenth of a step."""
_AS_IT_IS: Final = re.compile(r"/v1/(?!leaderboards)|/health|/metrics|.*\.mp4$")
_STEPPED: Final = re.compile(_STEP.replace("{episode}", r"([^/\0]+)"))


class PagesCompressed:
    """Compress pages, styles, scripts and rankings for who accepts it. Steps and films stay as they are."""

    def __init__(self, app: ASGIApp) -> None:
        self._plain, self._compressed = app, GZipMiddleware(app, minimum_size=1000, compresslevel=5)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        of_pages = scope["type"] == "http" and scope["method"] == "GET" and not _AS_IT_IS.match(scope["path"])
        await (self._compressed if of_pages else self._plain)(scope, receive, send)


class Middleware:
    """Plain ASGI middleware; Starlette's class for middleware would make a task of every request.

    It answers steps itself, by ``step`` with the request and the episode's id: nearly all requests are steps.
    """

    def __init__(self, app: ASGIApp, telemetry: Telemetry, step: Callable[[Request, str], Awaitable[Response]]) -> None:
        self._app = app
        self._step = step
        self._telemetry = telemetry
        self._log = structlog.get_logger("requests")
        self._refusals = logs.LogThrottle()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began = time.perf_counter()
        request_id = logs.begin_request(scope["path"])
        status = 0
        step = _STEPPED.fullmatch(scope["path"]) if scope["method"] == "POST" else None

        async def watched(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                message["headers"].append((b"x-request-id", request_id.encode()))
            await send(message)

        try:
            if step is None:
                _check_text(scope)
                await self._app(scope, receive, watched)
            else:
                response = await self._step(Request(scope, receive), step[1])
                await response(scope, receive, watched)
        except Exception as error:
            if status:
                raise
            await response_for(Request(scope), as_service_error(error))(scope, receive, watched)
        finally:
            # The route's pattern, never the path: a metric for each id would grow without end.
            route = getattr(scope.get("route"), "path", "unknown") if step is None else _STEP
            seconds = time.perf_counter() - began
            method = scope["method"] if scope["method"] in _METHODS else "other"
            self._telemetry.answered(method, route, status, seconds)
            if step is None:
                self._write_line(scope["method"], route, status, seconds)

    def _write_line(self, method: str, route: str, status: int, seconds: float) -> None:
        """Log a request. Of refusals, which strangers can cause without end, only some have the level info."""
        log = self._log.debug if route in _QUIET else self._log.info
        others: int | None = 0
        if 400 <= status < 500 or status == _QUOTA_REACHED:
            others = self._refusals.others(status)
            log = self._log.debug if others is None else log
        more = {"others": others} if others else {}
        log("request", method=method, route=route, status=status, seconds=round(seconds, 6), **more)


def _check_text(scope: Scope) -> None:
    """Check that an address has no NUL, which no id and no name has and PostgreSQL does not take.

    Raises:
        NotFoundError: The path has one.
        InvalidRequestError: The query has one.
    """
    if "\0" in scope["path"]:
        raise NotFoundError(ProblemType.UNKNOWN_ROUTE, "there is no such call: its path has the character NUL")
    if b"%00" in scope["query_string"] or b"\0" in scope["query_string"]:
        raise InvalidRequestError("query", "has the character NUL; leave it out")
