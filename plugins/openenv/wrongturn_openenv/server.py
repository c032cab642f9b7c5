"""Runs uvicorn. Clients may connect as soon as the URL is printed: the socket listens already."""

import asyncio
import logging
import socket
import sys
from collections.abc import Callable
from types import FrameType
from typing import Final

import uvicorn
from typing_extensions import override

from wrongturn_client.errors import WrongturnError
from wrongturn_openenv.app import STOP_S, create_app
from wrongturn_openenv.session import Service

READY: Final = "Wrongturn speaks OpenEnv at "
_LARGEST: Final = 1 << 16
"""Most bytes of a client's message; an action has about 60."""
_PING_TIMEOUT_S: Final = 600.0
"""Seconds that a trainer may compute without answering pings, as long as its episode's lease."""
_GRACE_S: Final = 10
"""Seconds after which a client that takes no more bytes is cut off."""


def bind(host: str, port: int) -> socket.socket:
    """Bind an address and listen on it."""
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        raise WrongturnError(f"--host {host} --port {port}: {error.strerror or error}; name another") from None


def run(service: Service, sessions: int, listening: socket.socket) -> None:
    """Serve until SIGTERM or SIGINT, at most so many sessions at a time."""
    app = create_app(service, sessions)
    config = uvicorn.Config(
        app,
        # Compressing pictures costs more than it saves.
        ws="websockets-sansio",
        ws_per_message_deflate=False,
        ws_max_size=_LARGEST,
        ws_ping_timeout=_PING_TIMEOUT_S,
        timeout_graceful_shutdown=_GRACE_S,
        access_log=False,
        log_level="warning",
    )
    host, port = listening.getsockname()[:2]
    sys.stdout.write(f"{READY}http://{f'[{host}]' if ':' in host else host}:{port}\n")
    sys.stdout.flush()
    _Server(config, app.state.stop).run(sockets=[listening])
    # A call that still waits would log that it does not reach the service that this command ends next.
    logging.getLogger("wrongturn_client").setLevel(logging.ERROR)


class _Server(uvicorn.Server):
    """Exits soon and with status 0 on a signal."""

    def __init__(self, config: uvicorn.Config, stop: Callable[[], None]) -> None:
        super().__init__(config)
        self._stop_calls = stop

    @override
    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        # Uvicorn waits for calls, and a reset may wait for the service much longer than one waits for a stop.
        asyncio.get_running_loop().call_later(STOP_S, self._stop_calls)
        await super().shutdown(sockets)

    @override
    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        # Uvicorn's own handler has the signal raised again at the end, which would make a clean stop look like a crash.
        self.force_exit = self.should_exit  # by the second signal
        self.should_exit = True
