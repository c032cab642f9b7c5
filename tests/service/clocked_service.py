"""A service in a thread of the test's process whose clocks the test moves, so that no time-out has to be waited out."""

import asyncio
import contextlib
import gc
import signal
import socket
import threading
from collections.abc import Coroutine, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import structlog
from app_harness import Clock, database_at
from fake_pool import FakePool
from fastapi import FastAPI
from service_harness import Service
from typing_extensions import override

from wrongturn_service.app import create_app
from wrongturn_service.server import Server, configuration
from wrongturn_service.settings import Settings
from wrongturn_service.submissions.local_runners import COMMAND

T = TypeVar("T")


class ClockedLoop(asyncio.SelectorEventLoop):
    """An event loop whose time is ahead of the real time by what the test adds to it."""

    ahead = 0.0

    @override
    def time(self) -> float:
        return super().time() + self.ahead


class ClockedService(Service):
    """One service behind real sockets, with simulators that only count.

    Its time-outs go by the loop's clock, which the test moves. Leases and the queue for simulators go by the test's
    clock alone: for them no time passes while the test works, however slow the machine is.
    """

    def __init__(
        self,
        database: Path,
        slots: int = 2,
        runner: Sequence[str] = COMMAND,
        pool: FakePool | None = None,
        **settings: Any,
    ) -> None:
        # A service collects the garbage at its start. In what the tests have imported, that takes a third of a second.
        gc.freeze()
        given = Settings(database=database_at(database), home=database.parent, simulators=slots, **settings)
        self._runner = asyncio.Runner(loop_factory=ClockedLoop)
        self._loop = cast(ClockedLoop, self._runner.get_loop())
        self._clock = Clock()
        self._exit = contextlib.ExitStack()
        self._exit.enter_context(self._clock.used())
        self.logs = self._exit.enter_context(structlog.testing.capture_logs())
        """What this service has logged."""
        bound = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{bound.getsockname()[1]}"
        self._app = create_app(given, pool=pool or FakePool(slots), runner=runner)
        self._server = Server(configuration(self._app, given), self._app, self.url, given.shutdown_grace_s)
        self._started = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(bound,), daemon=True)
        self._thread.start()
        assert self._started.wait(120), "the service did not start"
        assert self._server.started, self._app.state.startup_error

    def _run(self, bound: socket.socket) -> None:
        async def serve() -> None:
            serving = asyncio.ensure_future(self._server.serve([bound]))
            while not (self._server.started or serving.done()):  # noqa: ASYNC110 - nobody tells of it
                await asyncio.sleep(0.001)
            self._started.set()
            await serving
            for connection in self._server.server_state.connections:  # uvicorn abandons them at the second signal
                connection.transport.abort()
            await _settled()

        try:
            with bound, self._runner:
                self._runner.run(serve())
        finally:
            self._started.set()

    def pass_time(self, seconds: float) -> None:
        """Let so many seconds go by for the service, after it has dealt with all that has arrived."""

        async def shift() -> None:
            await _settled()
            self._loop.ahead += seconds
            self._clock.now += seconds
            await _settled()

        self.do(shift())

    def do(self, work: Coroutine[Any, Any, T]) -> T:
        """Do something in the service's event loop."""
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(60)

    @property
    def app(self) -> FastAPI:
        """The application."""
        return self._app

    @property
    def connections(self) -> int:
        """Number of open connections."""
        return len(self._server.server_state.connections)

    @property
    def at_rest(self) -> bool:
        """Whether no connection is open and no request is under way; one may outlive its connection."""
        return not (self._server.server_state.connections or self._server.server_state.tasks)

    def signal(self) -> None:
        """Do what the signal SIGTERM does."""
        self._loop.call_soon_threadsafe(self._server.handle_exit, signal.SIGTERM, None)

    @property
    def running(self) -> bool:
        """Whether the service has not ended yet."""
        return self._thread.is_alive()

    def join(self) -> None:
        """Wait for the end of a service that was told to stop."""
        self._thread.join(240)
        assert not self.running, "the service does not end"

    def close(self) -> None:
        """End the service at once."""
        if self.running:
            self.signal()
            with contextlib.suppress(RuntimeError):  # it may have ended meanwhile
                self.signal()
        self.join()
        self._exit.close()
        gc.unfreeze()  # a service freezes all objects at its start; those of this one are to be collected


async def _settled() -> None:
    """Turn the loop often enough for everything that has arrived to be handled."""
    for _ in range(50):
        await asyncio.sleep(0)
