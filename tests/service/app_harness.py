"""The service's application in this process, with simulators of the test's own."""

import asyncio
import contextlib
import functools
import re
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from unittest.mock import patch

import httpx
import structlog
from fake_pool import FakePool
from service_harness import GAS, expect

from wrongturn_service.app import create_app
from wrongturn_service.episodes import episodes
from wrongturn_service.episodes.queue import SimulatorQueue
from wrongturn_service.episodes.resets import Closings
from wrongturn_service.settings import Settings
from wrongturn_service.storage.database import Database


@functools.cache
def _no_rows() -> bytes:
    """A database as a service leaves it that nobody has called. Its tables take a third of a start."""

    async def make(file: Path) -> None:
        await (await Database.open(f"sqlite+aiosqlite:///{file}")).close()

    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(1) as other:
        file = Path(folder) / "a.db"
        other.submit(asyncio.run, make(file)).result()  # in this thread a loop may be running
        return file.read_bytes()


def database_at(file: Path) -> str:
    """The URL of a database, which is made unless it is there."""
    if not file.exists():
        file.touch(0o600)
        file.write_bytes(_no_rows())
    return f"sqlite+aiosqlite:///{file}"


class Clock:
    """A clock that the test moves."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now

    @contextlib.contextmanager
    def used(self) -> Iterator[None]:
        """Let leases, the queue for simulators and idle evaluations of new services go by this clock."""
        with contextlib.ExitStack() as stack:
            stack.enter_context(patch.object(SimulatorQueue.__init__, "__defaults__", (self,)))
            stack.enter_context(patch.dict(episodes.Episodes.__init__.__kwdefaults__, clock=self))
            # The database's times are the real ones.
            stack.enter_context(patch.object(Closings.__init__, "__defaults__", (lambda: time.time() + self.now,)))
            # A service looks at its leases by the real clock. It does so often, so that tests need not wait for it.
            stack.enter_context(patch.object(episodes, "LEASES_EVERY_S", 0.005))
            yield


def _unrendered_logs() -> contextlib.AbstractContextManager[object]:
    """Keep structlog from rendering each line for a terminal, which takes seconds for a traceback."""
    rendered = any(isinstance(one, structlog.dev.ConsoleRenderer) for one in structlog.get_config()["processors"])
    return structlog.testing.capture_logs() if rendered else contextlib.nullcontext()


@contextlib.asynccontextmanager
async def application(
    folder: Path, pool: FakePool | None = None, track: str = "privileged", **settings: Any
) -> AsyncIterator[httpx.AsyncClient]:
    """Run the application; leases and the queue go by ``http.clock``, which stands still unless the test moves it."""
    database = settings.pop("database", None) or database_at(folder / "a.db")
    given = Settings(database=database, home=folder, **settings)
    clock = Clock()
    with clock.used(), _unrendered_logs():
        app = create_app(given, pool=pool or FakePool())
        async with app.router.lifespan_context(app):
            transport = httpx.ASGITransport(app)
            async with httpx.AsyncClient(transport=transport, base_url="http://test", timeout=120) as http:
                http.app = app  # type: ignore[attr-defined]
                http.clock = clock  # type: ignore[attr-defined]
                if settings.get("registration") != "operator":
                    agent = expect(await http.post("/v1/agents", json={"name": "one", "track": track}), 201)
                    http.headers["Authorization"] = f"Bearer {agent['token']}"
                yield http


async def register(http: httpx.AsyncClient, path: str = "/v1/agents", **body: object) -> httpx.Response:
    """Register as somebody without a token."""
    request = http.build_request("POST", path, json=body)
    request.headers.pop("Authorization", None)
    return await http.send(request)


def play(story: Callable[[], Awaitable[None]]) -> None:
    asyncio.run(asyncio.wait_for(story(), 240))  # type: ignore[arg-type]


async def step(http: httpx.AsyncClient, episode: str, seq: int, action: dict[str, float] = GAS) -> httpx.Response:
    return await http.post(f"/v1/episodes/{episode}/step", json={"seq": seq, "action": action})


async def until(condition: Callable[[], bool]) -> None:
    for _ in range(6000):
        if condition():
            return
        await asyncio.sleep(0.01)
    raise AssertionError("it has not happened within a minute")


def without_own_script(page: str) -> str:
    """Return a page without the script that all pages have, so that any other one shows."""
    return re.sub(r'<script type="module" src="[./]+/static/page\.js"></script>', "", page)
