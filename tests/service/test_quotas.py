"""What an owner and an address may have: agents, open episodes and stored bytes."""

import asyncio
import shutil
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace

import httpx
import pytest
from app_harness import application, register, step
from fake_pool import FakePool
from service_harness import GAS, expect, problem
from sqlalchemy import func, select, update

from wrongturn_service.storage import usage
from wrongturn_service.storage.models import AgentRow, EpisodeRow, EvaluationRow, IdempotencyRow, OwnerRow
from wrongturn_service.storage.store import Store
from wrongturn_service.storage.usage import EPISODE_RESERVE, REPLY_RESERVE

PRACTICE = {"town": "Town01", "approach": "J3-S"}
MIB = 1 << 20
DAY_S = 86400.0


@asynccontextmanager
async def at(http: httpx.AsyncClient, address: str, **headers: str) -> AsyncIterator[httpx.AsyncClient]:
    """A client at an address, with a token of its own or none."""
    transport = httpx.ASGITransport(http.app, client=(address, 1))  # type: ignore[attr-defined]
    async with httpx.AsyncClient(transport=transport, base_url="http://test", headers=headers) as client:
        yield client


def store_of(http: httpx.AsyncClient) -> Store:
    store: Store = http.app.state.service.store  # type: ignore[attr-defined]
    return store


async def stored(http: httpx.AsyncClient) -> dict[str, int]:
    """Return the stored bytes of each owner, and check that no more are there than its quota counts."""
    async with store_of(http)._database.read() as session:
        known = (await session.execute(select(OwnerRow.name, OwnerRow.stored_bytes, usage.stored()))).tuples().all()
    for name, counted, size in known:
        assert size <= counted or name == "Wrongturn", name
    return {name: size for name, _, size in known}


async def drive_to_the_end(http: httpx.AsyncClient, episode: str) -> None:
    for seq in range(1, 11):
        expect(await step(http, episode, seq), 200)


async def practise(http: httpx.AsyncClient, **headers: str) -> str:
    episode: str = expect(await http.post("/v1/episodes", json=PRACTICE, headers=headers), 201)["id"]
    await drive_to_the_end(http, episode)
    return episode


async def test_agents_of_an_owner_and_accounts_of_an_address(tmp_path: Path) -> None:
    limits = {"agents_per_owner": 2, "accounts_per_address": 6, "operator_token": "secret"}
    async with application(tmp_path, FakePool(), **limits) as http, at(http, "192.0.2.1") as outside:
        owner = expect(await outside.post("/v1/owners", json={"name": "me"}), 201)
        mine = {"Authorization": f"Bearer {owner['token']}"}
        for number in range(2):
            body = {"name": f"mine {number}", "track": "camera"}
            expect(await outside.post("/v1/agents", json=body, headers=mine), 201)
        body = {"name": "mine 3", "track": "camera"}
        told = problem(await outside.post("/v1/agents", json=body, headers=mine), 507, "quota-reached")
        assert "2 agents" in told["detail"]
        assert "WRONGTURN_AGENTS_PER_OWNER" in told["detail"]
        expect(await outside.post("/v1/agents", json={"name": "a", "track": "camera"}), 201)
        # An owner, its two agents, and an agent with an owner of its own make five.
        problem(await outside.post("/v1/agents", json={"name": "b", "track": "camera"}), 507, "quota-reached")
        expect(await outside.post("/v1/owners", json={"name": "sixth"}), 201)
        told = problem(await outside.post("/v1/owners", json={"name": "seventh"}), 507, "quota-reached")
        assert "WRONGTURN_ACCOUNTS_PER_ADDRESS" in told["detail"]
        async with at(http, "192.0.2.2") as elsewhere:
            expect(await elsewhere.post("/v1/agents", json={"name": "b", "track": "camera"}), 201)
        operator = {"Authorization": "Bearer secret"}
        expect(await outside.post("/v1/owners", json={"name": "invited"}, headers=operator), 201)
        for number in range(3):
            body = {"name": f"baseline {number}", "track": "camera", "kind": "baseline"}
            expect(await outside.post("/v1/agents", json=body, headers=operator), 201)


async def test_open_episodes_of_an_owner_and_of_an_address(tmp_path: Path) -> None:
    # Two episodes of an agent, four of an owner, eight from an address; half of each for practice.
    async with application(tmp_path, FakePool(slots=12), max_open=2) as http:
        owner = expect(await register(http, "/v1/owners", name="me"), 201)
        mine = []
        for number in range(3):
            body = {"name": f"mine {number}", "track": "privileged"}
            headers = {"Authorization": f"Bearer {owner['token']}"}
            token = expect(await http.post("/v1/agents", json=body, headers=headers), 201)["token"]
            mine.append({"Authorization": f"Bearer {token}"})

        async def practise(headers: dict[str, str], refused: str = "") -> str:
            reply = await http.post("/v1/episodes", json=PRACTICE, headers=headers)
            if not refused:
                return str(expect(reply, 201)["id"])
            assert refused in problem(reply, 429, "rate-limited")["detail"]
            return ""

        held = await practise(mine[0])
        await practise(mine[1])
        await practise(mine[2], "this owner has 2 practice episodes")
        for headers in mine:
            evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}, headers=headers), 201)
            reset = await http.post(f"/v1/evaluations/{evaluation['id']}/episodes", headers=headers)
            if headers is not mine[2]:
                expect(reset, 201)
        assert "this owner has 4 episodes" in problem(reset, 429, "rate-limited")["detail"]
        # Other owners at the same address have what is left of the address's limit.
        others = [expect(await register(http, name=name, track="privileged"), 201) for name in ("x", "y", "z")]
        tokens = [{"Authorization": f"Bearer {other['token']}"} for other in others]
        await practise(tokens[0])
        await practise(tokens[1])
        await practise(tokens[2], "this address has 4 practice episodes")
        async with at(http, "192.0.2.2", **tokens[2]) as elsewhere:
            expect(await elsewhere.post("/v1/episodes", json=PRACTICE), 201)
        assert (await http.delete(f"/v1/episodes/{held}", headers=mine[0])).status_code == 204
        await practise(mine[2])


async def test_stored_bytes_are_those_of_the_rows(tmp_path: Path) -> None:
    """They grow and fall with what is stored, and a restart changes nothing."""
    async with application(tmp_path, FakePool(slots=4)) as http:
        fresh = (await stored(http))["one"]
        assert fresh == 2048  # the owner's row and the agent's
        headers = {"Idempotency-Key": "k"}
        held = expect(await http.post("/v1/episodes", json=PRACTICE, headers=headers), 201)["id"]
        assert (await stored(http))["one"] > fresh + EPISODE_RESERVE + REPLY_RESERVE
        await drive_to_the_end(http, held)
        practised = (await stored(http))["one"]
        assert fresh + 2048 < practised < fresh + EPISODE_RESERVE
        began = {"Idempotency-Key": "e"}
        wanted = {"suite": "smoke@3"}
        evaluation = expect(await http.post("/v1/evaluations", json=wanted, headers=began), 201)["id"]
        url = f"/v1/evaluations/{evaluation}/episodes"
        expect(await http.post(url, headers=headers | {"Idempotency-Key": "r"}), 201)
        reserved = (await stored(http))["one"]
        assert reserved > practised + 12 * EPISODE_RESERVE
        expect(await http.delete(f"/v1/evaluations/{evaluation}"), 200)
        # All that is left is the reply to the key that began it.
        assert (await stored(http))["one"] < practised + 4096
        expect(await http.post("/v1/episodes", json=PRACTICE), 201)  # lost by the restart
    async with application(tmp_path, FakePool(slots=4), registration="operator") as http:
        before = (await stored(http))["one"]
        assert before < practised + 8192
        await everything_is_old(http)
        assert (await stored(http))["one"] == fresh


async def everything_is_old(http: httpx.AsyncClient, unused_before: float = 0.0) -> None:
    later = time.time() + DAY_S
    await store_of(http).purge(
        practice_before=later, replies_before=later, abandoned_before=later, unused_before=unused_before
    )


async def test_an_evaluation_counts_what_it_can_come_to_until_it_is_finished(tmp_path: Path) -> None:
    async with application(tmp_path, FakePool(slots=4)) as http:
        fresh = (await stored(http))["one"]
        evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
        for number in range(12):
            headers = {"Idempotency-Key": f"r{number}"}
            reset = await http.post(f"/v1/evaluations/{evaluation}/episodes", headers=headers)
            await drive_to_the_end(http, expect(reset, 201)["id"])
        finished = (await stored(http))["one"]
        assert fresh + 12 * 2048 < finished < fresh + 12 * EPISODE_RESERVE
        rows = await store_of(http).episodes(evaluation)
        told = [
            {"episode": row.id, "steps": row.steps, "actions_sha256": row.actions_sha256 or "0" * 64} for row in rows
        ]
        url = f"/v1/evaluations/{evaluation}/results"
        for _ in range(2):
            expect(await http.put(url, json={"episodes": told}), 200)
        recorded = (await stored(http))["one"]
        assert finished + 1024 < recorded < finished + 8192
        problem(await http.put(url, json={"episodes": [], "versions": {"x" * 101: "1"}}), 422, "validation")
        problem(await http.put(url, json={"episodes": [], "versions": {"x": "1" * 201}}), 422, "validation")
        await everything_is_old(http, unused_before=time.time() + DAY_S)
        assert fresh + 12 * 2048 < (await stored(http))["one"] < recorded  # only the replies are gone


async def test_practice_makes_room_for_itself(tmp_path: Path, database_url: str) -> None:
    limits = {"bytes_per_owner": MIB, "bytes_per_address": 2 * MIB, "database": database_url}
    async with application(tmp_path, FakePool(slots=4), **limits) as http:
        first = await practise(http)
        for number in range(2):
            filler = await practise(http, **{"Idempotency-Key": f"k{number}"})
        await inflate(http, filler, MIB - 130_000)
        await practise(http)
        last = await practise(http)
        assert (await stored(http))["one"] < MIB
        problem(await http.get(f"/v1/episodes/{first}"), 404, "unknown-episode")
        expect(await http.get(f"/v1/episodes/{last}/trajectory"), 200)


async def inflate(http: httpx.AsyncClient, episode: str, size: int) -> None:
    """Let an episode count as so many bytes more."""
    async with store_of(http)._database.write() as session:
        row = await session.get(EpisodeRow, episode)
        assert row is not None
        agent = await session.get(AgentRow, row.agent_id)
        assert agent is not None
        row.stored_bytes += size
        await usage.Usage().add(session, agent.owner_id, size)


@pytest.mark.parametrize("which", ["bytes_per_owner", "bytes_per_address"])
async def test_what_does_not_fit_is_refused_and_leaves_nothing(tmp_path: Path, which: str) -> None:
    async with application(tmp_path, FakePool(slots=4), **{which: MIB}) as http:
        told = problem(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 507, "quota-reached")
        whose = "the address that registered this owner" if "address" in which else "this owner"
        assert f": {whose} has 0.0" in told["detail"]
        assert "of 1.05 MB, its quota; " in told["detail"]
        assert told["detail"].endswith(f"to raise WRONGTURN_{which.upper()}")
        assert told["detail"].startswith("an evaluation reserves 1.47 MB, which do not fit now (at its end")
        assert "retry-after" not in told
        held = expect(await http.post("/v1/episodes", json=PRACTICE), 201)["id"]
        await inflate(http, held, MIB - 200_000)
        before = await stored(http)
        for _ in range(2):
            told = problem(await http.post("/v1/episodes", json=PRACTICE), 507, "quota-reached")
            assert told["detail"].startswith("0.123 MB more do not fit: ")
        assert await stored(http) == before
        await drive_to_the_end(http, held)  # what is begun is stored


async def test_a_disk_that_is_nearly_full_takes_neither_registrations_nor_practice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with application(tmp_path, disk_reserve=1 << 30) as http:
        evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
        disk = SimpleNamespace(total=100 << 30, used=0, free=(1 << 30) - 1)
        monkeypatch.setattr(shutil, "disk_usage", lambda _: disk)
        for response in (
            await register(http, name="late", track="camera"),
            await register(http, "/v1/owners", name="late"),
            await http.post("/v1/episodes", json={"town": "Town01", "approach": "J3-S"}),
        ):
            assert "lower WRONGTURN_DISK_RESERVE" in problem(response, 507, "storage-failed")["detail"]
        expect(await http.post(f"/v1/evaluations/{evaluation}/episodes"), 201)
        disk.free += 1
        expect(await register(http, name="late", track="camera"), 201)


async def test_an_address_that_fills_the_disk_keeps_to_its_quota_and_others_drive_on(tmp_path: Path) -> None:
    limits = {"bytes_per_address": 3 * MIB, "registration_limit": 10_000, "accounts_per_address": 10_000}
    async with application(tmp_path, FakePool(slots=16), **limits) as http, at(http, "192.0.2.9") as elsewhere:
        body = {"name": "other", "track": "privileged"}
        other = {"Authorization": f"Bearer {expect(await elsewhere.post('/v1/agents', json=body), 201)['token']}"}
        statuses = set()
        for turn in range(500):
            texts = {"track": "camera", "description": "y" * 2000}
            keys = [{"Idempotency-Key": f"{what} {turn}"} for what in ("practice", "evaluation")]
            answers = await asyncio.gather(
                *(register(http, name=f"agent {turn} {number}", **texts) for number in range(8)),
                register(http, "/v1/owners", name=f"owner {turn}", contact="y" * 100),
                http.post("/v1/episodes", json=PRACTICE, headers=keys[0]),
                http.post("/v1/evaluations", json={"suite": "smoke@3"}, headers=keys[1]),
            )
            statuses |= {answer.status_code for answer in answers}
            if answers[-1].status_code == 201:
                expect(await http.delete(f"/v1/evaluations/{answers[-1].json()['id']}"), 200)
                await inflate(http, expect(answers[-2], 201)["id"], 7 * MIB // 4)
            sizes = await stored(http)
            assert sum(size for name, size in sizes.items() if name not in {"other", "Wrongturn"}) <= 3 * MIB
            if all(answer.status_code == 507 for answer in answers[:9]):
                break
        problem(answers[0], 507, "quota-reached")
        assert {201, 507} <= statuses <= {201, 409, 429, 503, 507}
        begun = expect(await elsewhere.post("/v1/episodes", json=PRACTICE, headers=other), 201)["id"]
        step_of = {"seq": 1, "action": GAS}
        expect(await elsewhere.post(f"/v1/episodes/{begun}/step", json=step_of, headers=other), 200)


async def test_owners_that_never_drove_and_lost_episodes_are_deleted(tmp_path: Path) -> None:
    async with application(tmp_path, FakePool(slots=4), operator_token="secret") as http:
        evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
        episode = expect(await http.post(f"/v1/evaluations/{evaluation}/episodes"), 201)["id"]
        await store_of(http).lose_episode(episode)
        expect(await register(http, name="idle", track="privileged"), 201)
        token = expect(await register(http, name="busy", track="privileged"), 201)["token"]
        busy = {"Authorization": f"Bearer {token}"}
        expect(await http.post("/v1/episodes", json=PRACTICE, headers=busy), 201)
        operator = {"Authorization": "Bearer secret"}
        expect(await http.post("/v1/owners", json={"name": "invited"}, headers=operator), 201)
        await everything_is_old(http)
        assert {"one", "idle", "busy", "invited"} < set(await stored(http))
        assert await store_of(http).episode(episode) is not None  # its evaluation is running
        await everything_is_old(http, unused_before=time.time() + DAY_S)
        assert set(await stored(http)) == {"one", "busy", "invited", "Wrongturn"}
        expect(await register(http, name="idle", track="privileged"), 201)  # the name is free
        async with store_of(http)._database.write() as session:
            await session.execute(update(EvaluationRow).values(state="cancelled"))
        await everything_is_old(http)
        assert await store_of(http).episode(episode) is None
        async with store_of(http)._database.read() as session:
            assert await session.scalar(select(func.count()).select_from(IdempotencyRow)) == 0
