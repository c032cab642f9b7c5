"""Limits per agent, and the error at each limit."""

import asyncio
from pathlib import Path
from typing import Any

import httpx
from app_harness import application, register, step, until
from fake_pool import FakePool
from service_harness import expect, problem

PRACTICE = {"town": "Town01", "approach": "J3-S"}


def _told(response: httpx.Response, status: int, kind: str) -> dict[str, Any]:
    told = problem(response, status, kind)
    assert int(response.headers["retry-after"]) >= 1
    assert told["position"] >= 1
    return told


async def _agent(http: httpx.AsyncClient, name: str) -> dict[str, str]:
    agent = expect(await register(http, name=name, track="privileged"), 201)
    return {"Authorization": f"Bearer {agent['token']}"}


async def test_each_has_a_place_in_the_line_and_comes_to_its_turn(tmp_path: Path) -> None:
    async with application(tmp_path, FakePool(slots=1)) as http:
        others = [await _agent(http, f"other {number}") for number in range(3)]

        async def ask(number: int) -> httpx.Response:
            headers = {**others[number], "Idempotency-Key": "one"}
            return await http.post("/v1/episodes", json=PRACTICE, headers=headers)

        held = expect(await http.post("/v1/episodes", json=PRACTICE), 201)["id"]
        for number in range(3):
            assert _told(await ask(number), 503, "simulators-busy")["position"] == number + 1
        metrics = (await http.get("/metrics")).text
        assert "wrongturn_simulators_awaited 3.0" in metrics
        assert (await http.delete(f"/v1/episodes/{held}")).status_code == 204
        # The next one's, though another asks first, and so does who just gave it back.
        _told(await ask(2), 503, "simulators-busy")
        _told(await http.post("/v1/episodes", json=PRACTICE), 503, "simulators-busy")
        first = expect(await ask(0), 201)["id"]
        assert expect(await ask(0), 201)["id"] == first  # its key's reply
        assert _told(await ask(1), 503, "simulators-busy")["position"] == 1


async def test_a_simulator_that_dies_is_replaced_though_others_wait(tmp_path: Path) -> None:
    pool = FakePool(slots=1)
    async with application(tmp_path, pool) as http:
        episode = expect(await http.post("/v1/episodes", json=PRACTICE), 201)["id"]
        other = await _agent(http, "other")
        _told(await http.post("/v1/episodes", json=PRACTICE, headers=other), 503, "simulators-busy")
        expect(await step(http, episode, 1), 200)
        pool.deaths_at_step += [None]
        expect(await step(http, episode, 2), 200)
        assert pool.replays == 1
        _told(await http.post("/v1/episodes", json=PRACTICE, headers=other), 503, "simulators-busy")


async def test_an_abort_without_a_simulator_is_told_its_place_too(tmp_path: Path) -> None:
    pool = FakePool(slots=1)
    async with application(tmp_path, pool, lease_release_s=10) as http:
        silent = expect(await http.post("/v1/episodes", json=PRACTICE), 201)["id"]
        expect(await step(http, silent, 1), 200)
        http.clock.now += 10
        await until(lambda: not pool.taken)
        other = await _agent(http, "other")
        busy = expect(await http.post("/v1/episodes", json=PRACTICE, headers=other), 201)["id"]
        expect(await http.post(f"/v1/episodes/{busy}/step", json=_step(1), headers=other), 200)
        _told(await http.delete(f"/v1/episodes/{silent}"), 503, "simulators-busy")
        assert (await http.delete(f"/v1/episodes/{busy}", headers=other)).status_code == 204
        assert (await http.delete(f"/v1/episodes/{silent}")).status_code == 204
        assert not pool.taken


async def test_an_episode_whose_time_is_over_waits_its_turn_and_may_still_be_gone_on_with(tmp_path: Path) -> None:
    pool = FakePool(slots=1)
    async with application(tmp_path, pool, lease_release_s=10, lease_abort_s=40) as http:
        service = http.app.state.service  # type: ignore[attr-defined]
        silent = expect(await http.post("/v1/episodes", json=PRACTICE), 201)["id"]
        expect(await step(http, silent, 1), 200)
        http.clock.now += 10
        await until(lambda: not pool.taken)
        other = await _agent(http, "other")
        busy = expect(await http.post("/v1/episodes", json=PRACTICE, headers=other), 201)["id"]
        for seq in range(1, 9):
            expect(await http.post(f"/v1/episodes/{busy}/step", json=_step(seq), headers=other), 200)
            http.clock.now += 9
            await asyncio.sleep(0.02)  # the service looks at its leases
        assert service.episodes.open == 2
        assert (await http.delete(f"/v1/episodes/{busy}", headers=other)).status_code == 204
        await until(lambda: service.episodes.open == 0)
        row = await service.store.episode(silent)
        assert (row.verdict, row.steps) == ("aborted", 1)
        assert not pool.taken


def _step(seq: int) -> dict[str, Any]:
    return {"seq": seq, "action": {"steer": 0.0, "throttle": 0.5, "brake": 0.0}}


async def test_so_many_open_episodes_of_an_agent(tmp_path: Path) -> None:
    async with application(tmp_path, FakePool(slots=8), max_open=4) as http:
        evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
        url = f"/v1/evaluations/{evaluation}/episodes"
        scored = expect(await http.post(url), 201)["id"]
        for _ in range(2):
            expect(await http.post("/v1/episodes", json=PRACTICE), 201)
        _told(await http.post("/v1/episodes", json=PRACTICE), 429, "rate-limited")
        expect(await http.post(url), 201)
        assert "DELETE" in _told(await http.post(url), 429, "rate-limited")["detail"]
        other = await _agent(http, "other")
        expect(await http.post("/v1/episodes", json=PRACTICE, headers=other), 201)
        assert (await http.delete(f"/v1/episodes/{scored}")).status_code == 204
        expect(await http.post(url), 201)


async def test_so_many_calls_of_an_agent_wait(tmp_path: Path) -> None:
    async with application(tmp_path, FakePool(slots=1), max_waiting=2, max_line=3) as http:
        expect(await http.post("/v1/episodes", json=PRACTICE), 201)

        async def ask(key: int, headers: dict[str, str]) -> httpx.Response:
            return await http.post("/v1/episodes", json=PRACTICE, headers={**headers, "Idempotency-Key": f"k{key}"})

        for key in range(2):
            _told(await ask(key, {}), 503, "simulators-busy")
        _told(await ask(2, {}), 429, "rate-limited")
        others = [await _agent(http, f"other {number}") for number in range(2)]
        assert _told(await ask(0, others[0]), 503, "simulators-busy")["position"] == 1
        full = _told(await ask(0, others[1]), 503, "simulators-busy")
        assert "the limit" in full["detail"]


async def test_a_refused_reset_takes_nothing_of_the_limit(tmp_path: Path) -> None:
    pool = FakePool(slots=1)
    async with application(tmp_path, pool, max_open=4) as http:
        held = expect(await http.post("/v1/episodes", json=PRACTICE), 201)["id"]
        for _ in range(5):
            _told(await http.post("/v1/episodes", json=PRACTICE), 503, "simulators-busy")
        await http.delete(f"/v1/episodes/{held}")
        pool.refuse = True
        for _ in range(3):
            problem(await http.post("/v1/episodes", json=PRACTICE), 422, "fault-not-applicable")
        pool.refuse = False
        expect(await http.post("/v1/episodes", json=PRACTICE), 201)
