"""Evaluations in towns that their secret makes: no call waits for one, and what is lost is built again."""

import asyncio
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import orjson
import psutil
import pytest
from app_harness import application, step, until
from service_harness import expect, problem

from wrongturn_networks import load_suite
from wrongturn_networks.drawn import is_built
from wrongturn_networks.draws import halves
from wrongturn_service.episodes import draws, evaluations

SUITE = "wrong-command-unseen@1"


async def once_built(http: httpx.AsyncClient, method: str, url: str, **body: Any) -> httpx.Response:
    """Send a call, again and again while towns are built, as a client does."""
    for _ in range(600):
        response = await http.request(method, url, **body)
        if response.status_code != 503:
            return response
        told = problem(response, 503, "towns-not-built")
        assert "come again" in told["detail"]
        assert response.headers["retry-after"] == "2"
        await asyncio.sleep(0.2)
    raise AssertionError("the towns were not built within two minutes")


def kill_builder() -> bool:
    """Kill the process that builds towns, but not its own processes, and return whether there was one."""
    found = [one for one in psutil.Process().children() if "wrongturn_service.episodes.towns" in one.cmdline()]
    if busy := [one for one in found if one.children()]:
        busy[0].kill()
    return bool(busy)


async def test_a_draw_in_towns_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path))
    # So the towns of practice are the evaluation's, and are built once.
    monkeypatch.setattr(draws, "_AFTER_FAILURE_S", 0.0)
    monkeypatch.setattr(evaluations, "secrets", SimpleNamespace(token_hex=lambda _: SUITE))
    async with application(tmp_path) as http:
        begun = expect(await http.post("/v1/evaluations", json={"suite": SUITE}), 201)
        assert begun["trials"] == 120
        resets = f"/v1/evaluations/{begun['id']}/episodes"
        problem(await http.post(resets), 503, "towns-not-built")
        # The service ends before the towns are there; nothing is lost.
    async with application(tmp_path, registration="operator") as again:
        again.headers["Authorization"] = http.headers["Authorization"]
        problem(await again.post(resets), 503, "towns-not-built")
        await until(kill_builder)
        first = expect(await once_built(again, "POST", resets), 201)
        assert "town" not in first
        service = again.app.state.service  # type: ignore[attr-defined]
        order, _ = halves(load_suite(SUITE).open_draw, SUITE)
        assert orjson.loads((await service.store.episode(first["id"])).trial)["id"] == order[0].id
        assert expect(await again.get(f"/v1/suites/{SUITE}"), 200)["trials"] == 60
        trials = expect(await once_built(again, "GET", f"/v1/suites/{SUITE}/trials"), 200)["trials"]
        wanted = {"suite": SUITE, "trial": trials[7]["twin"]}
        practice = expect(await once_built(again, "POST", "/v1/episodes", json=wanted), 201)
        assert (practice["trial"], practice["town"]) == (trials[7]["twin"], trials[7]["town"])
        town = order[0].town
        described = {"town": town, "approach": order[0].approach}
        problem(await again.post("/v1/episodes", json=described), 404, "unknown-town")
        # Its pages need the towns again, whatever became of them meanwhile.
        expect(await step(again, first["id"], 1), 200)
        agent = expect(await again.delete(f"/v1/evaluations/{begun['id']}"), 200)["agent"]
        shutil.rmtree(tmp_path / "towns" / town)
        page = f"/agents/{agent}"
        problem_page = await again.get(page)
        assert (problem_page.status_code, problem_page.headers["retry-after"]) == (503, "2")
        await until(lambda: is_built(town))


async def test_towns_that_cannot_be_built_are_told(tmp_path: Path) -> None:
    (tmp_path / "towns").write_text("no folder")
    async with application(tmp_path) as http:
        begun = expect(await http.post("/v1/evaluations", json={"suite": SUITE}), 201)
        for _ in range(300):
            response = await http.post(f"/v1/evaluations/{begun['id']}/episodes")
            if "cannot be built" in problem(response, 503, "towns-not-built")["detail"]:
                break
            await asyncio.sleep(0.2)
        assert "WRONGTURN_HOME" in response.json()["detail"]
        assert response.headers["retry-after"] == "30"
