"""Around every request: its time, and the last resort for exceptions that nobody expected."""

import time

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from wrongturn_service.api.errors import as_service_error, problem_response
from wrongturn_service.telemetry import Telemetry


class Middleware:
    """Plain ASGI: a step costs no more for it than two clock readings."""

    def __init__(self, app: ASGIApp, telemetry: Telemetry) -> None:
        self._app = app
        self._telemetry = telemetry

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began = time.perf_counter()
        status = 0

        async def watched(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
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
            self._telemetry.answered(scope["method"], route, status, time.perf_counter() - began)
