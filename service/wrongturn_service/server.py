"""Runs uvicorn. It prints the URL once the service is ready, and errors of the start in one line."""

import asyncio
import contextlib
import gc
import resource
import signal
import socket
import sys
import time
from functools import partial
from types import FrameType
from typing import cast

import structlog
import uvicorn
from fastapi import FastAPI
from typing_extensions import override

from wrongturn_protocol import wire
from wrongturn_service.app import create_app
from wrongturn_service.errors import StartupError
from wrongturn_service.service import Service
from wrongturn_service.settings import Settings
from wrongturn_service.socket.guards import Guard, GuardedHttp
from wrongturn_service.socket.protocol import DirectWebSocket

READY = "Wrongturn is ready at "
_KEEP_ALIVE_S = 75
"""Seconds that an idle connection stays open: an agent may think between two steps."""
_SWITCH_S = 0.001
"""Seconds that a thread may compute while the event loop waits for it. Python's default is 0.005."""
_SILENT_S = 1.0
"""A stop does not wait for agents that have been silent for so many seconds."""
_LOOK_S = 0.05
_IMPATIENT = 2
_OWN_DESCRIPTORS = 64
"""File descriptors of the database, the log, uploads and submissions."""
_PER_SIMULATOR = 4
_EVERYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # noqa: S104 - what to call instead


class Server(uvicorn.Server):
    """Prints its URL once it is ready, and exits with status 0 on a signal."""

    def __init__(self, config: uvicorn.Config, app: FastAPI, url: str, grace_s: float) -> None:
        super().__init__(config)
        self._app = app
        self._url = url
        self._grace_s = grace_s
        self._asked = 0

    @override
    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        # Objects of the start live for ever. Frozen, they do not slow down garbage collection.
        gc.collect()
        gc.freeze()
        if self.started and not self.should_exit:
            for listening in sockets or ():
                # Before this nobody would answer the runners.
                await self._app.state.service.dispatcher.open(own_url(listening))
            sys.stdout.write(f"{READY}{self._url}\n")
            sys.stdout.flush()

    @override
    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        began = time.monotonic()
        service: Service | None = getattr(self._app.state, "service", None)
        if service is not None:
            await service.dispatcher.stop()
            await self._drain(service)
        # Requests that began late get the rest of the grace period.
        left = self._grace_s - (time.monotonic() - began)
        self.config.timeout_graceful_shutdown = max(1, int(left))
        await super().shutdown(sockets)

    @override
    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self._asked += 1
        # Uvicorn's own handler has the signal raised again at the end, which would make a clean stop look like a crash.
        if self.should_exit and sig == signal.SIGINT:
            self.force_exit = True
        self.should_exit = True

    async def _drain(self, service: Service) -> None:
        """Refuse new episodes and wait for agents that are driving."""
        service.episodes.stopping = True
        log = structlog.get_logger("server")
        deadline = time.monotonic() + self._grace_s
        log.info("stopping", open=service.episodes.open)
        # A second signal ends the wait.
        while (  # noqa: ASYNC110 - silence is no event
            service.episodes.driven(_SILENT_S) and time.monotonic() < deadline and self._asked < _IMPATIENT
        ):
            await asyncio.sleep(_LOOK_S)
        if service.episodes.open:
            log.warning("episodes are lost by the stop; their trials run again", count=service.episodes.open)


def own_url(listening: socket.socket) -> str:
    """Return the URL at which a program of this machine reaches a socket that listens."""
    host, port = listening.getsockname()[:2]
    if host in _EVERYWHERE:
        host = _EVERYWHERE[host]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def configuration(app: FastAPI, settings: Settings) -> uvicorn.Config:
    """Return uvicorn's configuration."""
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    guard = Guard(
        min(settings.max_connections, for_connections(limit, settings.most_simulators)),
        settings.slow_client_s,
        lambda reason: app.state.telemetry.closed.labels(reason).inc(),
    )
    return uvicorn.Config(
        app,
        loop="uvloop",
        http=cast(type[asyncio.Protocol], partial(GuardedHttp, guard=guard)),
        ws=cast(type[asyncio.Protocol], partial(DirectWebSocket, guard=guard)),
        # Compressing pictures costs more than it saves. The service's own limit gives a clearer error.
        ws_per_message_deflate=False,
        ws_max_size=2 * wire.LARGEST,
        ws_ping_interval=settings.ping_interval_s,
        ws_ping_timeout=settings.ping_timeout_s,
        lifespan="on",
        access_log=False,
        log_config=None,
        log_level="critical",
        server_header=False,
        timeout_keep_alive=_KEEP_ALIVE_S,
        proxy_headers=True,
        forwarded_allow_ips=settings.proxies,
    )


def for_connections(limit: int, simulators: int) -> int:
    """Return for how many connections the process's file descriptors are enough.

    Without any left, the database and the simulators could open nothing. So the last ones, at most half, are for them.
    """
    return limit - min(_OWN_DESCRIPTORS + _PER_SIMULATOR * simulators, limit // 2)


def warn_if_few(limit: int, simulators: int, connections: int) -> None:
    """Log a warning if the process may not have the descriptors for so many connections."""
    there = for_connections(limit, simulators)
    if there < connections:
        structlog.get_logger("server").warning(
            "few file descriptors",
            limit=limit,
            connections=there,
            remedy=f"raise the hard limit (ulimit -Hn, LimitNOFILE=) to {connections + limit - there}, "
            f"or set WRONGTURN_MAX_CONNECTIONS to {there}",
        )


def run(settings: Settings, bound: socket.socket) -> None:
    """Serve until SIGTERM or SIGINT.

    The socket is closed at the end.

    Raises:
        StartupError: The service cannot start.
    """
    sys.setswitchinterval(_SWITCH_S)
    host = f"[{settings.host}]" if ":" in settings.host else settings.host
    _, limit = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))
    warn_if_few(limit, settings.most_simulators, settings.max_connections)
    app = create_app(settings)
    server = Server(
        configuration(app, settings), app, f"http://{host}:{bound.getsockname()[1]}", settings.shutdown_grace_s
    )
    # Uvicorn raises SystemExit if the start fails; the code below says why.
    with bound, contextlib.suppress(SystemExit):
        server.run(sockets=[bound])
    error = app.state.startup_error
    if isinstance(error, StartupError):
        raise error
    if not server.started:
        raise StartupError("the application did not start; the log says why")
