"""Limits for HTTP and WebSocket connections: how many there may be, and how slow their clients may be.

Uvicorn waits for ever for a request's head, for the rest of a message, and for a client to read its reply. These
protocols close such a connection. A client that moves 64 KiB within the time may go on, however long it takes in all.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import structlog
from typing_extensions import override
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from wrongturn_protocol import ProblemType
from wrongturn_service.errors import ServiceError, UnavailableError
from wrongturn_service.socket.protocol import DirectWebSocket

PROGRESS: Final = 65536
"""Bytes that a client has to move within the time."""
_TOO_SLOW_CLOSE: Final = 1008
_PHRASES: Final = {408: "Request Timeout", 503: "Service Unavailable"}


@dataclass(frozen=True)
class Guard:
    """The limits.

    Attributes:
        most: connections at a time.
        patience_s: seconds for a request's head, for a message, and for a reply to be read.
        closed: called with the reason whenever a connection is closed.
    """

    most: int
    patience_s: float
    closed: Callable[[str], None]

    def report(self, reason: str, transport: asyncio.BaseTransport) -> None:
        """Count and log a connection that is being closed."""
        self.closed(reason)
        peer = transport.get_extra_info("peername")
        structlog.get_logger("connections").warning(
            "connection closed", reason=reason, address=peer[0] if isinstance(peer, tuple) else None
        )


class Patience:
    """A time limit for a client that has to do something."""

    def __init__(
        self,
        guard: Guard,
        on_timeout: Callable[[], None],
        moved: Callable[[], int] = lambda: 0,
        excused: Callable[[], bool] = lambda: False,
    ) -> None:
        """Set the limit; it does not run yet.

        Args:
            guard: has the seconds.
            on_timeout: called when the client has moved too little.
            moved: returns the number of bytes that have moved so far.
            excused: returns whether the client is not to blame.
        """
        self._seconds = guard.patience_s
        self._on_timeout = on_timeout
        self._moved = moved
        self._excused = excused
        self._alarm: asyncio.TimerHandle | None = None
        self._before = 0

    def begin(self) -> None:
        """Start the limit, unless it runs already."""
        if self._alarm is None:
            self._before = self._moved()
            self._alarm = asyncio.get_running_loop().call_later(self._seconds, self._look)

    def end(self) -> None:
        """Stop the limit. Safe to call more than once."""
        if self._alarm is not None:
            self._alarm.cancel()
            self._alarm = None

    def _look(self) -> None:
        self._alarm = None
        if self._excused() or self._moved() - self._before >= PROGRESS:
            self.begin()
        else:
            self._on_timeout()


class GuardedWriting(asyncio.BaseProtocol):
    """Mixed into a protocol of uvicorn's: closes the connection of a client that does not read its replies."""

    transport: asyncio.Transport

    def __init__(self, *arguments: Any, guard: Guard, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._guard = guard
        self._reading = Patience(guard, self._not_read, self._written)

    @override
    def connection_lost(self, exc: Exception | None) -> None:
        self._reading.end()
        super().connection_lost(exc)

    @override
    def pause_writing(self) -> None:
        super().pause_writing()
        self._reading.begin()

    @override
    def resume_writing(self) -> None:
        self._reading.end()
        super().resume_writing()

    def _written(self) -> int:
        return -self.transport.get_write_buffer_size()

    def _not_read(self) -> None:
        # A closing message would only wait behind what is not read.
        self._guard.report("slow-reader", self.transport)
        self.transport.abort()


class GuardedHttp(GuardedWriting, HttpToolsProtocol):
    """Uvicorn's HTTP within the limits."""

    def __init__(self, *arguments: Any, guard: Guard, **named: Any) -> None:
        super().__init__(*arguments, guard=guard, **named)
        self._head = Patience(guard, self._too_slow, excused=self._answering)

    @override
    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        if len(self.connections) > self._guard.most:
            self._refuse(
                "too-many",
                UnavailableError(
                    ProblemType.SERVICE_FULL,
                    f"{self._guard.most} connections are open, which is the limit; come back later",
                    retry_after_s=5,
                ),
            )
            return
        self._head.begin()

    @override
    def connection_lost(self, exc: Exception | None) -> None:
        self._head.end()
        super().connection_lost(exc)

    @override
    def on_message_begin(self) -> None:
        super().on_message_begin()
        self._head.begin()

    @override
    def on_headers_complete(self) -> None:
        self._head.end()
        super().on_headers_complete()

    @override
    def handle_websocket_upgrade(self) -> None:
        self._head.end()
        super().handle_websocket_upgrade()

    def _answering(self) -> bool:
        # The next request's head is not read while a reply is made.
        return self.cycle is not None and not self.cycle.response_complete

    def _too_slow(self) -> None:
        self._refuse(
            "slow-request",
            ServiceError(
                ProblemType.REQUEST_TIMEOUT,
                f"the request's head did not come within {self._guard.patience_s:g} s",
                status=408,
            ),
        )

    def _refuse(self, reason: str, error: ServiceError) -> None:
        self._guard.report(reason, self.transport)
        body = error.problem().model_dump_json().encode()
        headers = {
            "Content-Type": "application/problem+json",
            "Content-Length": str(len(body)),
            "Connection": "close",
            **error.headers,
        }
        lines = [f"HTTP/1.1 {error.status} {_PHRASES[error.status]}", *(f"{name}: {headers[name]}" for name in headers)]
        self.transport.write("\r\n".join([*lines, "", ""]).encode() + body)
        self.transport.close()


class GuardedWebSocket(GuardedWriting, DirectWebSocket):
    """Uvicorn's WebSocket within the limits."""

    def __init__(self, *arguments: Any, guard: Guard, **named: Any) -> None:
        super().__init__(*arguments, guard=guard, **named)
        self._received = 0
        self._message = Patience(guard, self._too_slow, lambda: self._received, lambda: self.read_paused)

    @override
    def connection_lost(self, exc: Exception | None) -> None:
        self._message.end()
        super().connection_lost(exc)

    @override
    def data_received(self, data: bytes) -> None:
        self._received += len(data)
        super().data_received(data)
        if self.incomplete:
            self._message.begin()
        else:
            self._message.end()

    def _too_slow(self) -> None:
        if self.close_sent or self.transport.is_closing():
            return
        self._guard.report("slow-message", self.transport)
        self.conn.fail(_TOO_SLOW_CLOSE, ProblemType.REQUEST_TIMEOUT.value)
        self.transport.write(b"".join(self.conn.data_to_send()))
        self.close_sent = True
        self.transport.close()
