"""What Prometheus, the log and the health calls tell is what happened."""

import asyncio
import json
import re
import socket
from importlib.metadata import version
from pathlib import Path

import httpx
import pytest
import structlog
from app_harness import application, play, step, until
from fake_pool import FakePool
from prometheus_client.parser import text_string_to_metric_families
from service_harness import expect, problem
from sqlalchemy.exc import OperationalError

from wrongturn_protocol import Verdict
from wrongturn_service.errors import StartupError
from wrongturn_service.storage.postgres import DatabaseTakenError

DOCUMENT = Path(__file__).parents[2] / "docs/monitoring.md"
TIMED = re.compile(r"_(seconds|bytes|created|fds)\b|_seconds_sum|_bucket|process_|build_info")
"""Figures that differ from one run to the next."""
PRACTICE = {"town": "Town01", "approach": "J3-S", "seed": 3}


async def figures(http) -> dict[str, float]:  # type: ignore[no-untyped-def]
    """All samples, by name and labels."""
    text = (await http.get("/metrics")).text
    return {
        sample.name
        + "".join(f",{value}" for _, value in sorted(sample.labels.items()) if sample.name[-7:] != "_bucket"): (
            sample.value
        )
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


async def test_steps_latencies_slots_and_ends(tmp_path: Path) -> None:
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
        episode = expect(await http.post(f"/v1/evaluations/{evaluation}/episodes"), 201)["id"]
        practice = expect(await http.post("/v1/episodes", json=PRACTICE), 201)["id"]
        for seq in range(1, 11):
            expect(await step(http, episode, seq), 200)
        now = await figures(http)
        assert now["wrongturn_steps_total"] == 10
        for name, count in (("reset", 2), ("step", 10), ("replay", 0)):
            assert now[f"wrongturn_simulation_seconds_count,{name}"] == count
            assert now[f"wrongturn_overhead_seconds_count,{name}"] == count
        whole = now["wrongturn_request_seconds_sum,POST,/v1/episodes/{episode}/step,200"]
        parts = now["wrongturn_overhead_seconds_sum,step"] + now["wrongturn_simulation_seconds_sum,step"]
        assert whole == pytest.approx(parts)
        assert "wrongturn_episodes_ended_total,true,exit_commanded" not in now, "hidden until the evaluation's end"
        assert now["wrongturn_open_episodes"] == 1
        assert (now["wrongturn_leases_held"], now["wrongturn_leases_released"]) == (1, 0)
        slots = ("slots", "running", "busy", "idle")
        names = ["wrongturn_simulator_slots", *(f"wrongturn_simulators_{name}" for name in slots[1:])]
        assert [now[name] for name in names] == [4, 1, 1, 0]
        assert now["wrongturn_simulators_awaited"] == 0
        assert (await http.delete(f"/v1/episodes/{practice}")).status_code == 204
        assert (await figures(http))["wrongturn_episodes_ended_total,false,aborted"] == 1


async def test_each_figure_is_documented_and_nothing_else_and_each_route_bears_its_name(tmp_path: Path) -> None:
    async with application(tmp_path) as http:
        text = (await http.get("/metrics")).text
        families = {family.name for family in text_string_to_metric_families(text)}
        there = {name for name in families if not name.endswith("_created")}
        documented = re.findall(r"^\| `((?:wrongturn|process)_\w+)` \|", DOCUMENT.read_text(), re.MULTILINE)
        assert sorted(name.removesuffix("_total") for name in documented) == sorted(there)
        build = next(line for line in text.splitlines() if line.startswith("wrongturn_build_info{"))
        assert f'version="{version("wrongturn-service")}"' in build
        assert build.endswith(" 1.0")
        for method in ("GET", "HEAD"):
            assert (await http.request(method, "/openapi.json")).status_code == 200
        assert (await http.get("/nowhere")).status_code == 404
        found = await figures(http)
        routes = [name.split(",")[1:] for name in found if name.startswith("wrongturn_request_seconds_count")]
        assert ["GET", "/openapi.json", "200"] in routes
        assert ["HEAD", "/openapi.json", "200"] in routes
        assert [route for route in routes if "unknown" in route] == [["GET", "unknown", "404"]]


async def test_scored_verdicts_are_counted_once_their_evaluation_is_finished(tmp_path: Path) -> None:
    async with application(tmp_path) as http:
        evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
        for driven in range(12):
            assert not [name for name in await figures(http) if "ended_total,true" in name], driven
            episode = expect(await http.post(f"/v1/evaluations/{evaluation}/episodes"), 201)["id"]
            if driven == 3:
                assert (await http.delete(f"/v1/episodes/{episode}")).status_code == 204
                continue
            for seq in range(1, 11):
                expect(await step(http, episode, seq), 200)
        now = await figures(http)
        ended = {name.rpartition(",")[2]: value for name, value in now.items() if "ended_total,true" in name}
        assert ended == {"aborted": 1, "exit_commanded": 11}


def test_hidden_verdicts_change_nothing_that_anybody_can_read(tmp_path: Path) -> None:
    """Two drives that differ in their verdicts alone look the same while their evaluations run."""
    shown = []

    async def story(folder: Path, verdict: Verdict) -> None:
        pool = FakePool()
        pool.end = verdict
        async with application(folder, pool) as http:
            evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
            listed = expect(await http.get("/v1/agents"), 200)["agents"]
            for _ in range(3):
                episode = expect(await http.post(f"/v1/evaluations/{evaluation}/episodes"), 201)["id"]
                for seq in range(1, 11):
                    expect(await step(http, episode, seq), 200)
            pages = ["/", "/agents", f"/agents/{listed[0]['id']}", "/leaderboards/smoke@3", "/v1/leaderboards/smoke@3"]
            pages += [f"/v1/evaluations/{evaluation}", f"/v1/evaluations/{evaluation}/episodes"]
            pages += [f"/v1/episodes/{episode}", f"/episodes/{episode}", f"/v1/episodes/{episode}/trajectory"]
            texts = [(await http.get(page)).text for page in pages]
            now = await figures(http)
            counted = {name: value for name, value in now.items() if not TIMED.search(name)}
            assert counted["wrongturn_steps_total"] == 30
            assert len(counted) > 40
            shown.append((counted, [plain(text) for text in texts]))

    for verdict in (Verdict.EXIT_COMMANDED, Verdict.OFF_ROAD):
        folder = tmp_path / verdict
        folder.mkdir()
        play(lambda folder=folder, verdict=verdict: story(folder, verdict))
    assert shown[0] == shown[1]


def plain(text: str) -> str:
    """A reply without what differs from drive to drive: ids, times and checksums."""
    return re.sub(r"(ag|ow|ev|ep)_\w+|[0-9a-f]{32,}|\d{4}-\d\d-\d\d[\w:.+ ]*|\b\d{10}\.\d+|\b\d\d:\d\d\b", "…", text)


async def test_metrics_with_a_token(tmp_path: Path) -> None:
    async with application(tmp_path, metrics_token="read", operator_token="all") as http:
        problem(await http.get("/metrics"), 401, "unauthenticated")
        for wrong in ("Bearer guess", "Basic read", "read"):
            problem(await http.get("/metrics", headers={"Authorization": wrong}), 401, "unauthenticated")
        for token in ("read", "all"):
            told = await http.get("/metrics", headers={"Authorization": f"Bearer {token}"})
            assert "wrongturn_steps_total" in told.text
    async with application(tmp_path, registration="operator", operator_token="all") as http:
        problem(await http.get("/metrics"), 401, "unauthenticated")
        assert (await http.get("/metrics", headers={"Authorization": "Bearer all"})).is_success


async def test_without_a_token_metrics_are_for_the_own_machine(tmp_path: Path) -> None:
    async with application(tmp_path) as http:
        for name in ("X-Forwarded-For", "Forwarded", "Via", "X-Real-IP"):
            problem(await http.get("/metrics", headers={name: "127.0.0.1"}), 401, "unauthenticated")
        own = ("127.0.0.1", "::1", "::ffff:127.0.0.1")
        for address in (*own, "192.0.2.7", "10.0.0.1", "::2", "::ffff:192.0.2.7", "testclient"):
            transport = httpx.ASGITransport(http.app, client=(address, 4000))
            async with httpx.AsyncClient(transport=transport, base_url="http://test") as stranger:
                assert (await stranger.get("/metrics")).status_code == (200 if address in own else 401), address


async def test_metrics_on_a_port_of_their_own(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    settings = {"metrics_port": port, "metrics_token": "read"}
    async with application(tmp_path, **settings) as http, httpx.AsyncClient() as reader:
        problem(await http.get("/metrics"), 404, "unknown-route")
        problem(await reader.get(f"http://127.0.0.1:{port}/metrics"), 401, "unauthenticated")
        headers = {"Authorization": "Bearer read"}
        told = await reader.get(f"http://127.0.0.1:{port}/metrics", headers=headers)
        assert "wrongturn_open_episodes 0.0" in told.text
        assert (await reader.get(f"http://127.0.0.1:{port}/v1/suites", headers=headers)).status_code == 404
        (tmp_path / "other").mkdir()
        with pytest.raises(StartupError, match=r"^WRONGTURN_METRICS_PORT: \d+: is in use on .*; name another port$"):
            async with application(tmp_path / "other", **settings):
                pass
    with pytest.raises(ConnectionRefusedError):
        await asyncio.open_connection("127.0.0.1", port)


async def test_what_the_infrastructure_cut_off(tmp_path: Path) -> None:
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
        episode = expect(await http.post(f"/v1/evaluations/{evaluation}/episodes"), 201)["id"]
        pool.deaths_at_step.append(None)
        expect(await step(http, episode, 1), 200)
        now = await figures(http)
        assert (now["wrongturn_replays_total"], now["wrongturn_simulation_seconds_count,replay"]) == (1, 1)
        pool.deaths_at_step += [None] * 9
        pool.deaths_at_reset += [None] * 9
        problem(await step(http, episode, 2), 410, "episode-lost")
        assert (await figures(http))["wrongturn_episodes_voided_total,simulators-failed"] == 1
        pool.deaths_at_step.clear()
        pool.deaths_at_reset.clear()
        assert (await http.delete(f"/v1/evaluations/{evaluation}")).is_success
        deleted = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
        expect(await http.post(f"/v1/evaluations/{deleted}/episodes"), 201)
        assert (await http.delete(f"/v1/evaluations/{deleted}")).is_success
        assert (await figures(http))["wrongturn_episodes_voided_total,cancelled"] == 1
        expect(await http.post("/v1/episodes", json=PRACTICE), 201)
    folder = tmp_path / "silent"
    folder.mkdir()
    async with application(folder, lease_release_s=10, lease_abort_s=600) as http:
        expect(await http.post("/v1/episodes", json=PRACTICE), 201)
        service = http.app.state.service
        http.clock.now += 10
        await until(lambda: service.episodes.held == 0)
        http.clock.now += 590
        await until(lambda: service.episodes.open == 0)
        assert (await figures(http))["wrongturn_leases_expired_total"] == 1
    async with application(tmp_path, registration="operator") as http:
        assert (await figures(http))["wrongturn_episodes_voided_total,service-ended"] == 1


async def test_ready_tells_the_truth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        expect(await http.get("/health/ready"), 200)
        pool.failure = "no libsumo"
        problem(await http.get("/health/ready"), 503, "simulator-failed")
        expect(await http.get("/health/live"), 200)
        pool.failure = None
        database = http.app.state.service.store._database
        for error in (DatabaseTakenError("x"), OperationalError("SELECT 1", {}, OSError())):

            def fail(error: Exception = error) -> None:
                raise error

            monkeypatch.setattr(database, "check", fail)
            problem(await http.get("/health/ready"), 503, "storage-failed")
        monkeypatch.undo()
        # Until the service's next try to write.
        while (await http.get("/health/ready")).status_code != 200:  # noqa: ASYNC110 - another's state is no event
            await asyncio.sleep(0.05)
        http.app.state.service.episodes.stopping = True
        problem(await http.get("/health/ready"), 503, "shutting-down")
        problem(await http.post("/v1/episodes", json=PRACTICE), 503, "shutting-down")
        expect(await http.get("/health/live"), 200)


async def test_the_log_carries_the_ids(tmp_path: Path) -> None:
    lines: list[dict[str, object]] = []
    structlog.configure(
        processors=[structlog.contextvars.merge_contextvars, lambda *now: lines.append(now[2]) or drop()]
    )
    try:
        async with application(tmp_path) as http:
            evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
            response = await http.post(f"/v1/evaluations/{evaluation}/episodes")
            episode = expect(response, 201)["id"]
            for seq in range(1, 11):
                expect(await step(http, episode, seq), 200)
            begun = next(line for line in lines if line.get("status") == 201 and "episodes" in line["route"])
            assert begun["request"] == response.headers["X-Request-Id"]
            assert (begun["evaluation"], begun["episode"]) == (evaluation, episode)
            done = next(line for line in lines if line["event"] == "episode finished")
            assert (done["evaluation"], done["episode"]) == (evaluation, episode)
            assert done["request"] != begun["request"]
            registered = next(line for line in lines if line.get("route") == "/v1/agents")
            assert "episode" not in registered
            assert "token" not in json.dumps(lines)
    finally:
        structlog.reset_defaults()


def drop() -> None:
    raise structlog.DropEvent
