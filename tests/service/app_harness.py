"""The service's application in this process, with simulators of the test's own."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import httpx
from fake_pool import FakePool
from service_harness import GAS, expect

from wrongturn_service.app import create_app
from wrongturn_service.settings import Settings


@contextlib.asynccontextmanager
async def application(
    folder: Path, pool: FakePool, track: str = "privileged", **settings: Any
) -> AsyncIterator[httpx.AsyncClient]:
    database = settings.pop("database", f"sqlite+aiosqlite:///{folder / 'a.db'}")
    given = Settings(database=database, home=folder, **settings)
    app = create_app(given, pool=pool)
    async with app.router.lifespan_context(app):
        transport = httpx.ASGITransport(app)
        async with httpx.AsyncClient(transport=transport, base_url="http://test", timeout=30) as http:
            http.app = app  # type: ignore[attr-defined]
            if settings.get("registration") != "operator":
                agent = expect(await http.post("/v1/agents", json={"name": "one", "track": track}), 201)
                http.headers["Authorization"] = f"Bearer {agent['token']}"
            yield http


def play(story: Callable[[], Awaitable[None]]) -> None:
    asyncio.run(asyncio.wait_for(story(), 60))  # type: ignore[arg-type]


async def step(http: httpx.AsyncClient, episode: str, seq: int, action: dict[str, float] = GAS) -> httpx.Response:
    return await http.post(f"/v1/episodes/{episode}/step", json={"seq": seq, "action": action})


async def until(condition: Callable[[], bool]) -> None:
    for _ in range(500):
        if condition():
            return
        await asyncio.sleep(0.01)
    raise AssertionError("it did not come to pass")
