"""An agent that was killed while a call of its was under way, and asks where it was: that call counts."""

import asyncio
from pathlib import Path
from typing import Any

import pytest
from app_harness import application, step
from fake_pool import FakePool
from service_harness import expect, problem

from wrongturn_service.episodes import resets
from wrongturn_service.simulators.simulator import Simulator


class HeldPool(FakePool):
    """Its simulators answer when the test says so."""

    def __init__(self) -> None:
        super().__init__()
        self.go_on = asyncio.Event()
        self.go_on.set()
        self._waits = asyncio.Event()

    async def hold(self, call: Any) -> asyncio.Task[Any]:
        """Make a call whose simulator does not answer, and return once it waits for it."""
        self.go_on.clear()
        self._waits.clear()
        task = asyncio.create_task(call)
        await self._waits.wait()
        return task

    async def acquire(self, town: tuple[str, int | None], agent: str) -> Simulator:
        simulator: Any = await super().acquire(town, agent)
        for name in ("reset", "step"):
            setattr(simulator, name, self._held(getattr(simulator, name)))
        return simulator

    def _held(self, call: Any) -> Any:
        async def held(*arguments: Any) -> Any:
            self._waits.set()
            await self.go_on.wait()
            return await call(*arguments)

        return held


async def under_way(call: Any) -> asyncio.Task[Any]:
    """Begin a call that cannot be answered yet."""
    task = asyncio.create_task(call)
    await asyncio.sleep(0.2)
    assert not task.done()
    return task


async def test_a_reset_or_a_step_that_is_under_way_is_told_when_it_is_done(tmp_path: Path) -> None:
    pool = HeldPool()
    async with application(tmp_path, pool) as http:
        evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
        path = f"/v1/evaluations/{evaluation}/episodes"
        reset = await pool.hold(http.post(path))
        back = await under_way(http.get(f"{path}?state=open"))
        pool.go_on.set()
        (found,) = expect(await back, 200)["episodes"]
        begun = expect(await reset, 201)
        assert (found["id"], found["seq"], found["last_reply"]) == (begun["id"], 0, begun)
        stepping = await pool.hold(step(http, begun["id"], 1))
        back = await under_way(http.get(f"/v1/episodes/{begun['id']}"))
        pool.go_on.set()
        assert expect(await back, 200)["last_reply"] == expect(await stepping, 200)


async def test_a_reset_that_takes_too_long_is_asked_for_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resets.InProgress.over, "__defaults__", (0.1,))

    pool = HeldPool()
    async with application(tmp_path, pool) as http:
        evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
        path = f"/v1/evaluations/{evaluation}/episodes"
        reset = await pool.hold(http.post(path))
        response = await http.get(f"{path}?state=open")
        problem(response, 503, "simulators-busy")
        assert response.headers["Retry-After"] == "1"
        assert expect(await http.get(path), 200)["episodes"] == []
        pool.go_on.set()
        expect(await reset, 201)
        assert len(expect(await http.get(f"{path}?state=open"), 200)["episodes"]) == 1
