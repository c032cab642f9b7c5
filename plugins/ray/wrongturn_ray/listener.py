"""Where programs on the nodes connect. Each names the secret of its start, and then belongs to who has started it."""

import asyncio
import contextlib
import hmac
import secrets
import socket
import ssl
from collections.abc import Callable, Coroutine, Iterator
from typing import Any, Final

import structlog
from typing_extensions import override

from wrongturn_ray.connecting import keep_watch
from wrongturn_service.logs import LogThrottle

_STRANGERS: Final = 256
"""Connections at a time that have not named a secret yet."""
_PATIENCE_S: Final = 10.0
"""Seconds in which a connection has to name one."""
_HELLO: Final = 512
"""Longest line with a secret, bytes."""
_BACKLOG: Final = 1024


class Expected:
    """A program that is to connect."""

    def __init__(self, protocol: Callable[[], asyncio.Protocol]) -> None:
        """``protocol`` makes what speaks with the program."""
        self.secret = secrets.token_hex(32)
        self.protocol = protocol
        self.connected: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        """Once it has connected, what it says of itself: its process and its node."""


class Listener:
    """Listens, and hands each connection to what expects it."""

    def __init__(self, tls: ssl.SSLContext | None = None) -> None:
        self._tls = tls
        self._socket: socket.socket | None = None
        self._expected: dict[str, Expected] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._log = structlog.get_logger("cluster")
        self._throttle = LogThrottle()

    async def open(self, host: str, port: int) -> int:
        """Listen; return the port, which port 0 leaves to the system. Raises OSError."""
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        (found, *_) = await asyncio.get_running_loop().getaddrinfo(host, port, family=family, type=socket.SOCK_STREAM)
        self._socket = socket.create_server(found[4][:2], family=family, backlog=_BACKLOG)
        self._socket.setblocking(False)
        self._begin(self._accept(self._socket))
        return int(self._socket.getsockname()[1])

    async def close(self) -> None:
        """Take no more connections, and close those of strangers."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._socket is not None:
            self._socket.close()

    @contextlib.contextmanager
    def expect(self, protocol: Callable[[], asyncio.Protocol]) -> Iterator[Expected]:
        """Expect one program until the block ends."""
        expected = Expected(protocol)
        self._expected[expected.secret] = expected
        try:
            yield expected
        finally:
            self._expected.pop(expected.secret, None)

    def claim(self, secret: bytes) -> Expected | None:
        """Return who expects the program that names a secret. It counts once."""
        found = [name for name in self._expected if hmac.compare_digest(name.encode(), secret)]
        return self._expected.pop(found[0]) if found else None

    def _begin(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _accept(self, listening: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                stream, address = await loop.sock_accept(listening)
            except OSError as error:  # no descriptors are left
                self._log.warning("no connection could be taken", reason=str(error))
                await asyncio.sleep(1.0)
                continue
            if len(self._tasks) > _STRANGERS:
                stream.close()
            else:
                self._begin(self._meet(stream, address))

    async def _meet(self, stream: socket.socket, address: object) -> None:
        """Hear the secret of a connection, or close it."""
        stranger = _Stranger(self)
        try:
            async with asyncio.timeout(_PATIENCE_S):
                keep_watch(stream)
                loop = asyncio.get_running_loop()
                await loop.connect_accepted_socket(lambda: stranger, stream, ssl=self._tls)
                await stranger.known
        except (OSError, TimeoutError) as error:  # ssl.SSLError is an OSError
            others = self._throttle.others("stranger")
            if others is not None:
                why = str(error) or "it said nothing"
                self._log.warning("a stranger connected", address=address, reason=why, others=others)
            stranger.close()
            stream.close()


class _Stranger(asyncio.Protocol):
    """A connection that has not named a secret yet."""

    def __init__(self, listener: Listener) -> None:
        self.known: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._listener = listener
        self._heard = bytearray()
        self._transport: asyncio.Transport | None = None

    @override
    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        self._transport = transport

    @override
    def data_received(self, data: bytes) -> None:
        self._heard += data
        hello, end, rest = self._heard.partition(b"\n")
        if (not end and len(hello) <= _HELLO) or self.known.done():
            return
        secret, _, about = hello.partition(b" ")
        expected = self._listener.claim(bytes(secret)) if end else None
        if expected is None:
            self.known.set_exception(ConnectionError("it knows no secret"))
            return
        assert self._transport is not None
        protocol = expected.protocol()
        self._transport.set_protocol(protocol)
        protocol.connection_made(self._transport)
        self.known.set_result(None)
        expected.connected.set_result(about.decode(errors="replace"))
        if rest:
            protocol.data_received(bytes(rest))

    @override
    def connection_lost(self, exc: Exception | None) -> None:
        if not self.known.done():
            self.known.set_exception(ConnectionError("it went away"))

    def close(self) -> None:
        """Close the connection at once."""
        self.known.cancel()
        if self._transport is not None:
            self._transport.abort()
