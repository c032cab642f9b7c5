"""A service behind real sockets in this thread's own event loop, which runs only while a test waits for something.

Its simulators only count, its leases and its line go by a clock that the test moves, and it can be started again on
its database.
"""

import asyncio
import contextlib
import socket
from collections.abc import Callable, Coroutine, MutableMapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar
from unittest.mock import patch

import httpx
import structlog
import uvicorn
import uvloop
from app_harness import Clock, database_at
from fake_pool import FakePool

from wrongturn_service.app import create_app
from wrongturn_service.episodes import evaluations
from wrongturn_service.server import configuration
from wrongturn_service.settings import Settings

T = TypeVar("T")
RELEASE_S = 10.0
ABORT_S = 600.0
SLOTS = 4
STEPS = 4
"""Of an episode until it is over."""
PARALLEL = 3
PRACTICE = 3
WAITING = 2
"""Calls of an agent that may stand in the line for a simulator."""


class ServedApp:
    """One service; ``wait`` lets it run until a coroutine of the test is done."""

    def __init__(self, folder: Path, slots: int = SLOTS) -> None:
        self.loop = uvloop.new_event_loop()
        self.pool = FakePool(slots)
        self.pool.steps = STEPS
        self.clock = Clock()
        """The clock of leases and of the queue for simulators."""
        self.errors: list[MutableMapping[str, Any]] = []
        """What was logged as an error."""
        self._settings = Settings(
            database=database_at(folder / "a.db"),
            home=folder,
            simulators=slots,
            max_parallel=PARALLEL,
            max_open=2 * PRACTICE,
            max_waiting=WAITING,
            slow_client_s=3600,
            ping_interval_s=3600,
            shutdown_grace_s=0.1,
            lease_release_s=RELEASE_S,
            lease_abort_s=ABORT_S,
            registration_limit=1_000_000,
            accounts_per_address=1_000_000,
            evaluation_idle_h=1_000_000,
            evaluation_days=1_000_000,
        )
        self._exit = contextlib.ExitStack()
        self._exit.enter_context(self.clock.used())
        self.secrets = 0
        """Secrets that a try has drawn so far. A try that is made again has to find the same ones."""
        self._exit.enter_context(patch.object(evaluations, "secrets", SimpleNamespace(token_hex=self._secret)))
        self._exit.callback(structlog.reset_defaults)
        structlog.configure(processors=[self._heard])
        self._start()

    def _secret(self, size: int) -> str:
        self.secrets += 1
        return f"{self.secrets:0{2 * size}x}"

    def _heard(self, _logger: object, level: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
        if level in {"error", "exception", "critical"}:
            self.errors.append(event)
        raise structlog.DropEvent

    def _start(self) -> None:
        bound = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{bound.getsockname()[1]}"
        self.app = create_app(self._settings, pool=self.pool)
        config = configuration(self.app, self._settings)
        # Between two calls the loop stands still for as long as the test thinks.
        config.timeout_keep_alive = 3600
        self._server = uvicorn.Server(config)
        self._server.capture_signals = contextlib.nullcontext  # type: ignore[method-assign]
        self._serving = self.loop.create_task(self._server.serve([bound]))
        self.wait(self._started())
        self.http = httpx.AsyncClient(base_url=self.url, timeout=120, verify=False)  # no certificates to load

    async def _started(self) -> None:
        while not self._server.started:
            assert not self._serving.done(), "the service did not start"
            await asyncio.sleep(0.001)

    def _stop(self) -> None:
        self.wait(self.http.aclose())
        self._server.should_exit = True
        self.wait(self._serving)

    def restart(self) -> None:
        """End the service, and start another one on its database."""
        self._stop()
        # Those of a service that has ended have ended with it.
        self.pool.taken.clear()
        self._start()

    def close(self) -> None:
        """End the service for good."""
        self._stop()
        self._exit.close()
        self.loop.run_until_complete(self.loop.shutdown_asyncgens())
        self.loop.close()

    def wait(self, work: "Coroutine[Any, Any, T] | asyncio.Task[T]") -> T:
        """What a coroutine comes to; the service runs meanwhile."""
        return self.loop.run_until_complete(asyncio.wait_for(work, 60))

    def beside(self, work: Callable[[], None]) -> None:
        """Do something in another thread while the service runs in this one, where its database's tasks are at home."""
        self.loop.run_until_complete(asyncio.wait_for(asyncio.to_thread(work), 240))

    def silence(self, seconds: float) -> None:
        """Let so much time go by for the leases, and the service do what it has to."""

        async def until_settled() -> None:
            episodes = self.app.state.service.episodes
            await asyncio.sleep(0.006)
            while episodes.held or (seconds >= ABORT_S and episodes.open):  # noqa: ASYNC110 - nobody tells of it
                await asyncio.sleep(0.006)

        self.clock.now += seconds
        self.wait(until_settled())
