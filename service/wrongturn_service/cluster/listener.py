"""Where programs on the nodes connect. Each names the secret of its start, and then belongs to who has started it."""

import asyncio
import contextlib
import hmac
import secrets
import ssl
from collections.abc import Callable, Iterator
from typing import Final

import structlog
from typing_extensions import override

from wrongturn_service.cluster.connecting import keep_watch

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
        self._server: asyncio.Server
        self._expected: dict[str, Expected] = {}
        self.strangers = 0
        self.log = structlog.get_logger("cluster")

    async def open(self, host: str, port: int) -> int:
        """Listen; return the port, which port 0 leaves to the system. Raises OSError."""
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: _Stranger(self), host, port, ssl=self._tls, backlog=_BACKLOG)
        return int(self._server.sockets[0].getsockname()[1])

    def close(self) -> None:
        """Take no more connections."""
        self._server.close()

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

    @property
    def full(self) -> bool:
        """Whether one more stranger is too many."""
        return self.strangers > _STRANGERS


class _Stranger(asyncio.Protocol):
    """A connection that has not named a secret yet."""

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self._heard = bytearray()
        self._transport: asyncio.Transport
        self._late: asyncio.TimerHandle
        self._known = False

    @override
    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        self._transport = transport
        self._listener.strangers += 1
        self._late = asyncio.get_running_loop().call_later(_PATIENCE_S, transport.abort)
        keep_watch(transport.get_extra_info("socket"))
        if self._listener.full:
            transport.abort()

    @override
    def data_received(self, data: bytes) -> None:
        self._heard += data
        hello, end, rest = self._heard.partition(b"\n")
        if not end and len(hello) <= _HELLO:
            return
        secret, _, about = hello.partition(b" ")
        expected = self._listener.claim(bytes(secret)) if end else None
        if expected is None or expected.connected.done():
            self._listener.log.warning("a stranger connected", address=self._transport.get_extra_info("peername"))
            self._transport.abort()
            return
        self._leave()
        protocol = expected.protocol()
        self._transport.set_protocol(protocol)
        protocol.connection_made(self._transport)
        expected.connected.set_result(about.decode(errors="replace"))
        if rest:
            protocol.data_received(bytes(rest))

    @override
    def connection_lost(self, exc: Exception | None) -> None:
        if not self._known:
            self._leave()

    def _leave(self) -> None:
        self._known = True
        self._late.cancel()
        self._listener.strangers -= 1
