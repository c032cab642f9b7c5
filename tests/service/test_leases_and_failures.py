"""Silent agents, busy and failing simulators, registration's limits: with simulators that only count."""

from pathlib import Path
from typing import Any

import pytest
from app_harness import application, register, step, until
from fake_pool import FakePool
from service_harness import GAS, expect, problem

from wrongturn_service.episodes import driver
from wrongturn_service.episodes.episodes import IDLE_S

PRACTICE = {"town": "Town01", "approach": "J3-S"}


async def test_a_silent_agents_simulator_goes_to_others_and_is_rebuilt(tmp_path: Path) -> None:
    pool = FakePool(slots=1)
    async with application(tmp_path, pool, lease_release_s=10) as http:
        silent = expect(await http.post("/v1/episodes", json=PRACTICE), 201)["id"]
        expect(await step(http, silent, 1), 200)
        problem(await http.post("/v1/episodes", json=PRACTICE), 503, "simulators-busy")
        http.clock.now += 10
        await until(lambda: not pool.taken)
        other = expect(await http.post("/v1/episodes", json=PRACTICE), 201)["id"]
        response = await step(http, silent, 2)
        problem(response, 503, "simulators-busy")
        assert int(response.headers["retry-after"]) >= 1
        assert (await http.delete(f"/v1/episodes/{other}")).status_code == 204
        assert expect(await step(http, silent, 2), 200)["observation"]["speed"] == 2.0
        assert pool.replays == 1


async def test_idle_simulators_of_those_who_hold_most_go_to_a_call_that_waits(tmp_path: Path) -> None:
    pool = FakePool(slots=4)
    async with application(tmp_path, pool) as http:

        async def another(name: str) -> dict[str, str]:
            token = expect(await register(http, name=name, track="privileged"), 201)["token"]
            return {"Authorization": f"Bearer {token}"}

        greedy, modest = await another("greedy"), await another("modest")
        held = [
            expect(await http.post("/v1/episodes", json=PRACTICE, headers=greedy), 201)["id"],
            *[expect(await http.post("/v1/episodes", json=PRACTICE), 201)["id"] for _ in range(3)],
        ]
        problem(await http.post("/v1/episodes", json=PRACTICE, headers=modest), 503, "simulators-busy")
        http.clock.now += 2 * IDLE_S
        expect(await step(http, held[1], 1), 200)  # it is not idle
        expect(await http.post("/v1/episodes", json=PRACTICE, headers=modest), 201)
        simulated = [one.simulator is not None for one in http.app.state.service.episodes.registry.values()]  # type: ignore[attr-defined]
        assert simulated[:2] == [True, True]
        assert sum(simulated) == 4
        problem(await http.post("/v1/episodes", json=PRACTICE), 503, "simulators-busy")  # it holds most
        # Its own next step may take the place of another episode of its own.
        lost = held[2 + simulated[2:4].index(False)]
        http.clock.now += 2 * IDLE_S
        assert expect(await step(http, lost, 1), 200)["observation"]["speed"] == 1.0


async def test_an_evaluation_keeps_its_simulator_from_its_first_step_on(tmp_path: Path) -> None:
    pool = FakePool(slots=1)
    async with application(tmp_path, pool) as http:
        evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
        episode = expect(await http.post(f"/v1/evaluations/{evaluation}/episodes"), 201)["id"]
        token = expect(await register(http, name="other", track="privileged"), 201)["token"]
        other = {"Authorization": f"Bearer {token}"}
        http.clock.now += 2 * IDLE_S
        practice = expect(await http.post("/v1/episodes", json=PRACTICE, headers=other), 201)["id"]
        http.clock.now += 2 * IDLE_S
        expect(await step(http, episode, 1), 200)
        assert pool.starts == 3
        http.clock.now += 2 * IDLE_S
        body = {"seq": 1, "action": GAS}
        problem(await http.post(f"/v1/episodes/{practice}/step", json=body, headers=other), 503, "simulators-busy")


async def test_an_agent_that_does_not_come_back(tmp_path: Path) -> None:
    pool = FakePool()
    async with application(tmp_path, pool, lease_release_s=10, lease_abort_s=600) as http:
        evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
        reset = expect(await http.post(f"/v1/evaluations/{evaluation}/episodes"), 201)
        assert reset["lease_expires_in_s"] == 600
        expect(await step(http, reset["id"], 1), 200)
        http.clock.now += 600
        await until(lambda: http.app.state.service.episodes.open == 0)  # type: ignore[attr-defined]
        problem(await step(http, reset["id"], 2), 409, "episode-finished")
        assert expect(await http.get(f"/v1/evaluations/{evaluation}"), 200)["finished"] == 1
        row = await http.app.state.service.store.episode(reset["id"])  # type: ignore[attr-defined]
        assert (row.verdict, row.steps) == ("aborted", 1)
        assert not pool.taken


async def test_a_simulator_that_dies_at_each_try_makes_the_episode_invalid_and_its_trial_runs_again(
    tmp_path: Path,
) -> None:
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
        episode = expect(await http.post(f"/v1/evaluations/{evaluation}/episodes"), 201)["id"]
        expect(await step(http, episode, 1), 200)
        pool.deaths_at_step += [None] * 4
        problem(await step(http, episode, 2), 410, "episode-lost")
        problem(await step(http, episode, 2), 410, "episode-lost")
        row = await http.app.state.service.store.episode(episode)  # type: ignore[attr-defined]
        assert row.verdict == "invalid"
        pool.deaths_at_step.clear()
        trials = []
        while (response := await http.post(f"/v1/evaluations/{evaluation}/episodes")).status_code == 201:
            again = response.json()["id"]
            trials.append((await http.app.state.service.store.episode(again)).trial_id)  # type: ignore[attr-defined]
            for seq in range(1, 11):
                last = expect(await step(http, again, seq), 200)
            assert last["terminated"]
        assert trials[0] == row.trial_id
        assert len(set(trials)) == len(trials) == 12
        assert expect(await http.get(f"/v1/evaluations/{evaluation}"), 200)["state"] == "finished"
        assert not pool.taken


async def test_a_replay_that_differs_is_never_gone_on_with(tmp_path: Path) -> None:
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        episode = expect(await http.post("/v1/episodes", json=PRACTICE), 201)["id"]
        expect(await step(http, episode, 1), 200)
        pool.deaths_at_step += [None]
        pool.drift = 0.5
        problem(await step(http, episode, 2), 410, "episode-lost")
        assert not pool.taken


async def test_a_few_deaths_are_not_noticed(tmp_path: Path) -> None:
    pool = FakePool()
    pool.deaths_at_reset += [None]
    pool.deaths_at_start += [None]
    async with application(tmp_path, pool) as http:
        episode = expect(await http.post("/v1/episodes", json=PRACTICE), 201)["id"]
        for seq in range(1, 10):
            if seq in {2, 5}:
                pool.deaths_at_step += [None] * 2
            if seq == 6:
                pool.deaths_at_step += [None]
                pool.deaths_at_start += [None] * 2
            if seq == 7:
                pool.deaths_at_step += [None]
                pool.deaths_at_reset += [None]
                pool.deaths_at_start += [None]
            assert expect(await step(http, episode, seq), 200)["observation"]["speed"] == seq
        assert not pool.deaths_at_start
        pool.deaths_at_abort += [None]
        assert (await http.delete(f"/v1/episodes/{episode}")).status_code == 204
        pool.deaths_at_reset += [None] * 3
        problem(await http.post("/v1/episodes", json=PRACTICE), 503, "simulator-failed")
        assert not pool.taken


async def test_simulators_that_never_start_are_told_after_a_few_tries(tmp_path: Path) -> None:
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        episode = expect(await http.post("/v1/episodes", json=PRACTICE), 201)["id"]
        expect(await step(http, episode, 1), 200)
        pool.deaths_at_start += [None] * 1000
        pool.deaths_at_step += [None]
        for call in (http.post("/v1/episodes", json=PRACTICE), step(http, episode, 2)):
            before = pool.starts
            refused = problem(await call, 503, "simulator-failed")
            assert "no simulator could be started" in refused["detail"]
            assert pool.starts - before == 3
        pool.deaths_at_start.clear()
        assert expect(await step(http, episode, 2), 200)["observation"]["speed"] == 2
        assert len(pool.taken) == 1


async def test_a_start_that_lasted_is_not_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        monkeypatch.setattr(driver, "START_PATIENCE_S", -1.0)
        pool.deaths_at_start += [None]
        problem(await http.post("/v1/episodes", json=PRACTICE), 503, "simulator-failed")
        assert pool.starts == 1


async def test_an_abort_needs_no_simulator_that_works(tmp_path: Path) -> None:
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        episode = expect(await http.post("/v1/episodes", json={**PRACTICE, "fault": "omission"}), 201)["id"]
        expect(await step(http, episode, 1), 200)
        pool.deaths_at_abort += [None] * 10
        assert (await http.delete(f"/v1/episodes/{episode}")).status_code == 204
        shown = expect(await http.get(f"/v1/episodes/{episode}"), 200)
        assert (shown["outcome"]["verdict"], shown["outcome"]["time"]) == ("aborted", 0.1)


async def test_so_many_episodes_of_an_evaluation_and_no_more(tmp_path: Path) -> None:
    async with application(tmp_path, max_parallel=2) as http:
        evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)
        assert evaluation["max_parallel"] == 2
        url = f"/v1/evaluations/{evaluation['id']}/episodes"
        for _ in range(2):
            expect(await http.post(url), 201)
        response = await http.post(url)
        problem(response, 409, "no-trial-available")
        assert response.headers["retry-after"] == "1"


async def test_so_many_registrations_from_one_address(tmp_path: Path) -> None:
    async with application(tmp_path, registration_limit=2, operator_token="secret") as http:
        owner = expect(await register(http, "/v1/owners", name="two"), 201)
        response = await register(http, name="three", track="camera")
        assert "WRONGTURN_REGISTRATION_LIMIT" in problem(response, 429, "rate-limited")["detail"]
        hers = {"Authorization": f"Bearer {owner['token']}"}
        for name in ("five", "six"):  # which count to their owner
            expect(await http.post("/v1/agents", json={"name": name, "track": "camera"}, headers=hers), 201)
        problem(await register(http, "/v1/owners", name="four"), 429, "rate-limited")
        assert 3500 < int(response.headers["retry-after"]) <= 3601
        headers = {"Authorization": "Bearer secret"}
        expect(await http.post("/v1/agents", json={"name": "four", "track": "camera"}, headers=headers), 201)


async def test_a_mistake_of_ours_tells_nothing_of_itself(tmp_path: Path) -> None:
    async with application(tmp_path) as http:
        service = http.app.state.service  # type: ignore[attr-defined]

        async def broken() -> None:
            raise KeyError("a secret of the house")

        service.store.ping = broken
        response = await http.get("/health/ready")
        problem(response, 500, "internal")
        assert "secret of the house" not in response.text


async def test_metrics_that_fail_are_computed_later(tmp_path: Path, monkeypatch: Any) -> None:
    from wrongturn_judge import metrics

    compute = metrics.compute

    async with application(tmp_path) as http:
        evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
        monkeypatch.setattr(metrics, "compute", lambda *_: 1 / 0)
        for _ in range(12):
            episode = expect(await http.post(f"/v1/evaluations/{evaluation}/episodes"), 201)["id"]
            assert (await http.delete(f"/v1/episodes/{episode}")).status_code == 204
        assert expect(await http.get(f"/v1/evaluations/{evaluation}"), 200)["state"] == "running"
        monkeypatch.setattr(metrics, "compute", compute)
        problem(await http.post(f"/v1/evaluations/{evaluation}/episodes"), 409, "evaluation-finished")
        assert expect(await http.get(f"/v1/evaluations/{evaluation}"), 200)["state"] == "finished"
