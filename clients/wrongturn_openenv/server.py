"""Runs uvicorn, and prints the URL once clients may connect."""

import contextlib
import signal
import socket
import sys
from collections.abc import Iterator
from typing import Final

import uvicorn
from typing_extensions import override

from wrongturn_client.errors import WrongturnError
from wrongturn_openenv.app import create_app
from wrongturn_openenv.session import Service

READY: Final = "Wrongturn speaks OpenEnv at "
_LARGEST: Final = 1 << 16
"""Most bytes of a client's message; an action has about 60."""
_PING_TIMEOUT_S: Final = 600.0
"""Seconds that a trainer may compute without answering pings, as long as its episode's lease."""
_GRACE_S: Final = 5


def bind(host: str, port: int) -> socket.socket:
    """Bind an address and listen on it.

    Raises:
        WrongturnError: It cannot be bound.
    """
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        raise WrongturnError(f"--host {host} --port {port}: {error.strerror or error}; name another") from None


def run(service: Service, sessions: int, listening: socket.socket) -> None:
    """Serve until SIGTERM or SIGINT.

    Args:
        service: The service that the sessions practise on.
        sessions: Most sessions at a time.
        listening: Socket that listens.
    """
    config = uvicorn.Config(
        create_app(service, sessions),
        # Compressing pictures costs more than it saves.
        ws="websockets-sansio",
        ws_per_message_deflate=False,
        ws_max_size=_LARGEST,
        ws_ping_timeout=_PING_TIMEOUT_S,
        timeout_graceful_shutdown=_GRACE_S,
        access_log=False,
        log_level="warning",
    )
    _Server(config).run(sockets=[listening])


class _Server(uvicorn.Server):
    """Prints its URL once it is ready, and exits with status 0 on a signal."""

    @override
    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        host, port = (sockets or [])[0].getsockname()[:2]
        sys.stdout.write(f"{READY}http://{f'[{host}]' if ':' in host else host}:{port}\n")
        sys.stdout.flush()

    @override
    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        # Uvicorn raises the signal again at the end, which would make a clean stop look like a crash.
        before = {number: signal.signal(number, self.handle_exit) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
