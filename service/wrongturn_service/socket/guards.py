"""Limits for HTTP and WebSocket connections: how many, how slow their clients may be, and how much they may send.

Uvicorn waits for ever for a request's head, for the rest of a message, and for a client to read its reply. These
protocols close such a connection. A client that moves 64 KiB within the time may go on, however long it takes in all.

Uvicorn also takes heads, trailers and queues of requests of any size, and answers control frames without end. It begins
all requests that came together in one turn of the event loop; here they take turns.
"""

import asyncio
import contextlib
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, cast

import structlog
from typing_extensions import override
from uvicorn._types import ASGI3Application
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

from wrongturn_protocol import FieldError, ProblemType
from wrongturn_service.errors import ServiceError, UnavailableError, too_many
from wrongturn_service.logs import LogThrottle

PROGRESS: Final = 65536
"""Bytes that a client has to move within the time."""
_HEAD: Final = 65536
"""Most bytes of a request besides its body: head, framing of chunks, trailers."""
_LINE: Final = 8000
"""Most bytes of the address, and of a header."""
_HEADERS: Final = 100
"""Most headers of a request."""
_FRAMING: Final = 64
"""Bytes of a body that excuse one byte of its framing: chunks of a large body may be as small as half a kibibyte."""
_PIECE: Final = 16384
"""Bytes that are parsed before the limits are looked at again."""
_QUEUED: Final = 32
"""Most requests of a connection that wait for the reply to an earlier one."""
_LINGER: Final = 1 << 20
_LINGER_S: Final = 2.0
"""Bytes and seconds of the rest of a refused body that are dropped. A reset at once would take away the reply."""
_PHRASES: Final = {
    400: "Bad Request",
    408: "Request Timeout",
    414: "URI Too Long",
    431: "Request Header Fields Too Large",
    503: "Service Unavailable",
}


class RequestTurns:
    """Begins requests one after the other, one in each turn of the event loop.

    All that came together in one turn would delay a step, which takes several turns, by several times their number.
    """

    def __init__(self) -> None:
        self._waiting: deque[Callable[[], None]] = deque()

    def take(self, begin: Callable[[], None]) -> None:
        """Call a function once all earlier ones had their turns."""
        self._waiting.append(begin)
        if len(self._waiting) == 1:
            asyncio.get_running_loop().call_soon(self._next)

    def _next(self) -> None:
        begin = self._waiting.popleft()
        if self._waiting:
            asyncio.get_running_loop().call_soon(self._next)
        begin()


@dataclass(frozen=True)
class Guard:
    """The limits."""

    most: int
    """Connections at a time."""
    patience_s: float
    """Seconds for a request's head, for a message, and for a reply to be read."""
    closed: Callable[[str], None]
    """Called with the reason whenever a connection is closed."""
    turns: RequestTurns = field(default_factory=RequestTurns)
    _seldom: LogThrottle = field(default_factory=LogThrottle)

    def report(self, reason: str, transport: asyncio.BaseTransport) -> None:
        """Count a connection that is being closed, and log it, but each reason at most once in ten seconds."""
        self.closed(reason)
        others = self._seldom.others(reason)
        if others is None:
            return
        peer = transport.get_extra_info("peername")
        structlog.get_logger("connections").warning(
            "connection closed",
            reason=reason,
            address=peer[0] if isinstance(peer, tuple) else None,
            **({"others": others} if others else {}),
        )


class ConnectionLimits:
    """Counts connections to ``WS /v1/drive``: at most ``each`` of an agent, and ``address`` from an address."""

    def __init__(self, *, each: int, address: int) -> None:
        self._each = each
        self._address = address
        self.open = 0
        """Number of open connections."""
        self._counts: Counter[str] = Counter()
        """By agent and by address. An id never looks like an address."""

    @contextlib.contextmanager
    def one(self, agent: str, address: str) -> Iterator[None]:
        """Count one more connection, opened with an agent's token from an address, until the block ends.

        Raises:
            UnavailableError: A limit is reached.
        """
        for who, whose, most in ((agent, "of this agent", self._each), (address, "from this address", self._address)):
            if self._counts[who] >= most:
                raise too_many(
                    f"{most} connections {whose} are open, which is the limit; one carries any number of episodes, so "
                    "use it, or close another"
                )
        self._counts.update((agent, address))
        self.open += 1
        try:
            yield
        finally:
            self.open -= 1
            self._counts -= Counter((agent, address))


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

        ``on_timeout`` is called when the client has moved too little. ``moved`` returns the number of bytes that have
        moved so far, ``excused`` whether the client is not to blame.
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


class _ReplyTransport:
    """What a reply is written to. It is closed as the protocol says."""

    def __init__(self, transport: asyncio.Transport, close: Callable[[], None]) -> None:
        self.write = transport.write
        self.is_closing = transport.is_closing
        self.close = close


class GuardedHttp(GuardedWriting, HttpToolsProtocol):
    """Uvicorn's HTTP within the limits."""

    def __init__(self, *arguments: Any, guard: Guard, **named: Any) -> None:
        super().__init__(*arguments, guard=guard, **named)
        self._head = Patience(guard, self._too_slow, excused=self._answering)
        self._in_head = True
        self._begun = False
        """Whether a part of a head has come."""
        self._extra = 0
        """Bytes of the request that are not its body, up to a piece more."""
        self._over = False
        """Whether nothing more is read here: the connection is refused, or it is a WebSocket now."""
        self._rest: int | None = None
        """Bytes that came after the last reply and were dropped. None before it."""
        self._unread: Callable[[], None] | None = None
        """Begins the request that waits until the replies before it are read."""

    @override
    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        if len(self.connections) > self._guard.most:
            detail = f"{self._guard.most} connections are open, which is the limit; come back later"
            self._refuse("too-many", UnavailableError(ProblemType.SERVICE_FULL, detail, retry_after_s=5))
        else:
            self._head.begin()

    @override
    def connection_lost(self, exc: Exception | None) -> None:
        self._head.end()
        super().connection_lost(exc)

    @override
    def data_received(self, data: bytes) -> None:
        if self._rest is not None:
            self._rest += len(data)
            if self._rest > _LINGER:
                self.transport.pause_reading()
            return
        for at in range(0, len(data), _PIECE):
            if self._over or self.transport.is_closing():
                return
            piece = data[at : at + _PIECE] if len(data) > _PIECE else data
            self._extra += len(piece)
            super().data_received(piece)
            if self._extra > _HEAD and not self._over:
                self._too_large(f"the request has more than {_HEAD} bytes besides its body")
        if self._begun:
            self._head.begin()

    @override
    def on_message_begin(self) -> None:
        super().on_message_begin()
        self._begun = True

    @override
    def on_headers_complete(self) -> None:
        self._begun = False
        self._head.end()
        if self._over:
            return
        if len(self.url) > _LINE:
            self._too_large(f"the address has more than {_LINE} bytes", status=414)
        elif len(self.headers) > _HEADERS:
            self._too_large(f"the request has more than {_HEADERS} headers")
        elif any(len(name) + len(value) > _LINE for name, value in self.headers):
            self._too_large(f"a header has more than {_LINE} bytes")
        elif (hosts := sum(name == b"host" for name, _ in self.headers)) != 1 and (
            hosts or self.parser.get_http_version() == "1.1"
        ):
            message = f"there are {hosts} Host headers; send exactly one"
            field = FieldError(path="header.host", message=message)
            error = ServiceError(ProblemType.VALIDATION, f"header.host: {message}", status=400, errors=[field])
            self._reject("hosts", error)
        else:
            self._in_head = False
            before = self.cycle
            super().on_headers_complete()
            if self.cycle is not before:  # a WebSocket has none
                self.headers = []  # takes the trailers, which are ignored
                self.cycle.transport = cast(asyncio.Transport, _ReplyTransport(self.transport, self._close))
            if len(self.pipeline) > _QUEUED:
                self._drop("pipelined")

    @override
    def on_body(self, body: bytes) -> None:
        self._extra = max(0, self._extra - len(body) - len(body) // _FRAMING)
        if not self._over:
            super().on_body(body)

    @override
    def on_message_complete(self) -> None:
        self._in_head, self._extra = True, 0
        if not self._over:
            super().on_message_complete()

    @override
    def handle_websocket_upgrade(self) -> None:
        if not self._over:
            self._over = True
            super().handle_websocket_upgrade()

    @override
    def resume_writing(self) -> None:
        super().resume_writing()
        begin, self._unread = self._unread, None
        if begin is not None:
            self._guard.turns.take(begin)

    @override
    def _start_asgi_task(self, cycle: RequestResponseCycle, app: ASGI3Application) -> None:
        begin = partial(self._begin, cycle, app)
        if self.flow.write_paused:
            self._unread = begin
        else:
            self._guard.turns.take(begin)

    def _begin(self, cycle: RequestResponseCycle, app: ASGI3Application) -> None:
        if not self.transport.is_closing():
            super()._start_asgi_task(cycle, app)

    def _close(self) -> None:
        """Close the connection after its last reply, but let a client that still sends its body read the reply."""
        if self.pipeline or not self.cycle.more_body or self._over or self.transport.is_closing():
            self.transport.close()
            return
        self._over, self._rest = True, 0
        self.transport.write_eof()
        asyncio.get_running_loop().call_later(_LINGER_S, self.transport.close)

    def _too_large(self, detail: str, status: int = 431) -> None:
        self._reject("head-too-large", ServiceError(ProblemType.HEAD_TOO_LARGE, f"{detail}; send less", status=status))

    def _reject(self, reason: str, error: ServiceError) -> None:
        """Refuse a request, if it is the one that is to be answered next; else end the connection."""
        waits = self._answering() and not self.cycle.response_started
        if self.pipeline or (self._answering() if self._in_head else not waits):
            self._drop(reason)
            return
        if not self._in_head:
            self.cycle.disconnected = True
            self.cycle.message_event.set()
        self._refuse(reason, error)

    def _drop(self, reason: str) -> None:
        self._over = True
        self._guard.report(reason, self.transport)
        self.transport.abort()

    def _answering(self) -> bool:
        # The next request's head is not read while a reply is made.
        return self.cycle is not None and not self.cycle.response_complete

    def _too_slow(self) -> None:
        detail = f"the request's head did not come within {self._guard.patience_s:g} s"
        self._refuse("slow-request", ServiceError(ProblemType.REQUEST_TIMEOUT, detail, status=408))

    def _refuse(self, reason: str, error: ServiceError) -> None:
        self._over = True
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
