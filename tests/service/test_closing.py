"""What is begun counts: one open evaluation, closed by its agent or for its silence, and never a second draw."""

import asyncio
import hashlib
import uuid
from pathlib import Path
from typing import Any

import httpx
import pytest
from app_harness import application, register, step
from fake_pool import FakePool
from service_harness import expect, problem
from sqlalchemy import text

from wrongturn_networks import load_suite
from wrongturn_protocol import EpisodeState, Leaderboard, SuiteDetail, TrialList
from wrongturn_service import service
from wrongturn_service.episodes.evaluations import RunningEvaluations
from wrongturn_service.storage.store import Store

SUITE = "smoke@3"


async def begin(http: httpx.AsyncClient, suite: str = SUITE) -> dict[str, Any]:
    return expect(await http.post("/v1/evaluations", json={"suite": suite}), 201)


async def reset(http: httpx.AsyncClient, evaluation: str) -> str:
    return str(expect(await http.post(f"/v1/evaluations/{evaluation}/episodes"), 201)["id"])


async def close(http: httpx.AsyncClient, evaluation: str) -> dict[str, Any]:
    return expect(await http.delete(f"/v1/evaluations/{evaluation}"), 200)


async def secret_of(http: httpx.AsyncClient, evaluation: str) -> str:
    row = await http.app.state.service.store.evaluation(evaluation)  # type: ignore[attr-defined]
    return str(row.secret)


async def drive(http: httpx.AsyncClient, evaluation: str) -> None:
    episode = await reset(http, evaluation)
    for seq in range(1, 11):
        expect(await step(http, episode, seq), 200)


async def test_one_open_evaluation_for_each_suite(tmp_path: Path) -> None:
    async with application(tmp_path) as http:
        replies = await asyncio.gather(*(http.post("/v1/evaluations", json={"suite": SUITE}) for _ in range(5)))
        (begun,) = [reply.json() for reply in replies if reply.status_code == 201]
        for reply in replies:
            if reply.status_code != 201:
                told = problem(reply, 409, "evaluation-open", "evaluation")
                assert begun["id"] in told["detail"]
                assert "DELETE" in told["detail"]
                assert told["errors"][0]["message"] == begun["id"]
        await begin(http, "navigation@1")
        other = expect(await register(http, name="other", track="privileged"), 201)
        headers = {"Authorization": f"Bearer {other['token']}"}
        expect(await http.post("/v1/evaluations", json={"suite": SUITE}, headers=headers), 201)


@pytest.mark.parametrize(("suite", "draw", "cells"), [("smoke@3", "open", 6), ("navigation@1", "listed", 0)])
async def test_a_suite_shows_its_cells_and_which_draw_its_trials_are(
    suite: str, draw: str, cells: int, tmp_path: Path
) -> None:
    async with application(tmp_path) as http:
        shown = SuiteDetail.model_validate(expect(await http.get(f"/v1/suites/{suite}"), 200))
        assert shown.cells == load_suite(suite).cells
        assert len(shown.cells) == cells
        trials = TrialList.model_validate(expect(await http.get(f"/v1/suites/{suite}/trials"), 200))
        assert trials.draw == draw
        for trial, cell in zip(trials.trials, shown.cells, strict=False):
            assert (trial.town, trial.junction_type, trial.fault) == (cell.town, cell.junction_type, cell.fault)


async def test_the_secret_is_promised_first_and_told_last(tmp_path: Path) -> None:
    async with application(tmp_path) as http:
        begun = await begin(http)
        assert begun["secret"] is None
        for _ in range(12):
            now = expect(await http.get(f"/v1/evaluations/{begun['id']}"), 200)
            assert (now["state"], now["secret"]) == ("running", None)
            assert now["commitment"] == begun["commitment"]
            await drive(http, begun["id"])
        async with httpx.AsyncClient(transport=http._transport, base_url="http://test") as stranger:
            told = expect(await stranger.get(f"/v1/evaluations/{begun['id']}"), 200)
            listed = expect(await stranger.get(f"/v1/evaluations/{begun['id']}/episodes"), 200)["episodes"]
        assert told["state"] == "finished"
        assert hashlib.sha256(told["secret"].encode()).hexdigest() == begun["commitment"]
        drawn = load_suite(SUITE).draw(told["secret"])
        assert {episode["trial"] for episode in listed} == {trial.id for trial in drawn.episodes}
        journeys = await begin(http, "navigation@1")
        assert (journeys["commitment"], journeys["secret"]) == (None, None)


async def test_a_key_does_not_bring_a_deleted_evaluation_back(tmp_path: Path) -> None:
    async with application(tmp_path) as http:
        key, of_reset = ({"Idempotency-Key": str(uuid.uuid4())} for _ in range(2))
        body = {"suite": SUITE}
        begun = expect(await http.post("/v1/evaluations", json=body, headers=key), 201)
        assert expect(await http.post("/v1/evaluations", json=body, headers=key), 201) == begun
        resets = f"/v1/evaluations/{begun['id']}/episodes"
        opened = expect(await http.post(resets, headers=of_reset), 201)
        assert expect(await http.post(resets, headers=of_reset), 201) == opened
        await close(http, begun["id"])
        told = problem(await http.post("/v1/evaluations", json=body, headers=key), 404, "unknown-evaluation")
        assert begun["id"] in told["detail"]
        assert "send a new Idempotency-Key" in told["detail"]
        problem(await http.post(resets, headers=of_reset), 404, "unknown-evaluation")
        assert (await begin(http))["id"] != begun["id"]


async def test_before_its_first_step_it_disappears_but_for_its_draw(tmp_path: Path) -> None:
    """Whoever looks at first observations and begins again sees the same trials."""
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        store = http.app.state.service.store  # type: ignore[attr-defined]
        first = await begin(http)
        secret = await secret_of(http, first["id"])
        for _ in range(2):
            begun = await begin(http) if first is None else first
            assert begun["commitment"] == hashlib.sha256(secret.encode()).hexdigest()
            episodes = [await reset(http, begun["id"]) for _ in range(3)]
            # Aborting is no step, and neither is practice.
            assert (await http.delete(f"/v1/episodes/{episodes[0]}")).status_code == 204
            practice = expect(await http.post("/v1/episodes", json={"town": "Town01", "approach": "J3-S"}), 201)
            expect(await step(http, practice["id"], 1), 200)
            assert (await close(http, begun["id"]))["state"] == "cancelled"
            problem(await http.get(f"/v1/evaluations/{begun['id']}"), 404, "unknown-evaluation")
            problem(await http.delete(f"/v1/evaluations/{begun['id']}"), 404, "unknown-evaluation")
            problem(await http.post(f"/v1/evaluations/{begun['id']}/episodes"), 404, "unknown-evaluation")
            for episode in episodes:
                problem(await step(http, episode, 1), 404, "unknown-episode")
                assert await store.episode(episode) is None
            assert (await http.delete(f"/v1/episodes/{practice['id']}")).status_code == 204
            assert not pool.taken
            first = None
        other = expect(await register(http, name="other", track="privileged"), 201)
        headers = {"Authorization": f"Bearer {other['token']}"}
        theirs = expect(await http.post("/v1/evaluations", json={"suite": SUITE}, headers=headers), 201)
        assert theirs["commitment"] != hashlib.sha256(secret.encode()).hexdigest()
        last = await begin(http)
        assert await secret_of(http, last["id"]) == secret
        await step(http, await reset(http, last["id"]), 1)
        await close(http, last["id"])
        assert await secret_of(http, (await begin(http))["id"]) != secret, "it was used"


async def test_after_its_first_step_what_is_missing_counts_as_aborted(tmp_path: Path) -> None:
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        begun = (await begin(http))["id"]
        await drive(http, begun)
        stepped, fresh = await reset(http, begun), await reset(http, begun)
        last = expect(await step(http, stepped, 1), 200)
        for _ in range(2):
            closed = await close(http, begun)
            assert (closed["state"], closed["finished"]) == ("finished", 12)
        assert closed["secret"] is not None
        outcomes = [verdict for counts in closed["metrics"]["verdicts"].values() for verdict in counts.items()]
        assert sum(count for verdict, count in outcomes if verdict == "aborted") == 11
        assert sum(count for verdict, count in outcomes if verdict == "exit_commanded") == 1
        assert expect(await step(http, stepped, 1), 200) == last
        problem(await step(http, stepped, 2), 409, "episode-finished")
        problem(await step(http, fresh, 1), 409, "episode-finished")
        problem(await http.post(f"/v1/evaluations/{begun}/episodes"), 409, "evaluation-finished")
        listed = expect(await http.get(f"/v1/evaluations/{begun}/episodes"), 200)["episodes"]
        assert sorted(episode["seq"] for episode in listed) == [0] * 10 + [1, 10]
        assert {episode["outcome"]["verdict"] for episode in listed} == {"aborted", "exit_commanded"}
        board = Leaderboard.model_validate_json((await http.get(f"/v1/leaderboards/{SUITE}")).text)
        assert [entry.evaluation for entry in board.entries] == [begun]
        assert not pool.taken
        # A later, better one is not the agent's entry.
        later = (await begin(http))["id"]
        for _ in range(12):
            await drive(http, later)
        board = Leaderboard.model_validate_json((await http.get(f"/v1/leaderboards/{SUITE}")).text)
        assert [entry.evaluation for entry in board.entries] == [begun]


async def test_closing_while_a_step_is_under_way(tmp_path: Path) -> None:
    async with application(tmp_path) as http:
        for seq in (1, 2):
            begun = (await begin(http))["id"]
            episode = await reset(http, begun)
            for before in range(1, seq):
                expect(await step(http, episode, before), 200)
            stepped, closed = await asyncio.gather(step(http, episode, seq), http.delete(f"/v1/evaluations/{begun}"))
            state = expect(closed, 200)["state"]
            if stepped.status_code == 200:
                assert state == "finished"
            elif state == "cancelled":
                problem(stepped, 404, "unknown-episode")
            else:
                problem(stepped, 409, "episode-finished")


@pytest.mark.parametrize("driven", [False, True])
@pytest.mark.parametrize(("late", "after"), [("acquire", False), ("add_episode", False), ("add_episode", True)])
async def test_closing_while_an_episode_begins(tmp_path: Path, driven: bool, late: str, after: bool) -> None:
    """The reset waits at its simulator, or before or after its row is stored, until the evaluation is closed."""
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        store = http.app.state.service.store  # type: ignore[attr-defined]
        begun = (await begin(http))["id"]
        if driven:
            await drive(http, begun)
        place = pool if late == "acquire" else store
        real, waits, closed = getattr(place, late), asyncio.Event(), asyncio.Event()

        async def wait(*arguments: Any) -> Any:
            found = await real(*arguments) if after else None
            waits.set()
            await closed.wait()
            return found if after else await real(*arguments)

        setattr(place, late, wait)
        beginning = asyncio.create_task(http.post(f"/v1/evaluations/{begun}/episodes"))
        await waits.wait()
        await close(http, begun)
        closed.set()
        if driven:
            problem(await beginning, 409, "evaluation-finished")
            assert len(await store.episodes(begun, EpisodeState.FINISHED)) == 12
        else:
            problem(await beginning, 404, "unknown-evaluation")
        assert not pool.taken
        assert http.app.state.service.episodes.open == 0  # type: ignore[attr-defined]


async def test_deleting_while_the_trials_are_laid_out(tmp_path: Path) -> None:
    async with application(tmp_path) as http:
        begun = (await begin(http))["id"]
        store = http.app.state.service.store  # type: ignore[attr-defined]
        trials = store.trials_by_state

        async def late(evaluation_id: str) -> Any:
            await http.delete(f"/v1/evaluations/{begun}")
            return await trials(evaluation_id)

        store.trials_by_state = late
        for _ in range(2):
            problem(await http.post(f"/v1/evaluations/{begun}/episodes"), 404, "unknown-evaluation")


async def test_a_service_that_dies_between_closing_and_metrics(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from wrongturn_judge import metrics

    with monkeypatch.context() as broken:
        broken.setattr(metrics, "compute", lambda *_: 1 / 0)
        async with application(tmp_path) as http:
            begun = (await begin(http))["id"]
            await drive(http, begun)
            closed = await close(http, begun)
            assert (closed["state"], closed["finished"], closed["secret"]) == ("running", 12, None)
            problem(await http.post(f"/v1/evaluations/{begun}/episodes"), 409, "evaluation-finished")
            token = http.headers["Authorization"]
    async with application(tmp_path, registration="operator") as http:
        http.headers["Authorization"] = token
        told = expect(await http.get(f"/v1/evaluations/{begun}"), 200)
        assert (told["state"], told["finished"]) == ("finished", 12)


async def test_the_first_step_counts_though_the_service_dies(tmp_path: Path) -> None:
    async with application(tmp_path) as http:
        begun = (await begin(http))["id"]
        expect(await step(http, await reset(http, begun), 1), 200)
        token = http.headers["Authorization"]
    async with application(tmp_path, registration="operator") as http:
        http.headers["Authorization"] = token
        assert (await close(http, begun))["state"] == "finished"


HOUR_S = 3600.0


async def state_of(http: httpx.AsyncClient, evaluation: str) -> str:
    row = await http.app.state.service.store.evaluation(evaluation)  # type: ignore[attr-defined]
    return "deleted" if row is None else str(row.state)


async def becomes(http: httpx.AsyncClient, evaluation: str, state: str) -> None:
    for _ in range(6000):
        if await state_of(http, evaluation) == state:
            return
        await asyncio.sleep(0.01)
    raise AssertionError(f"it is {await state_of(http, evaluation)}, not {state}")


async def test_an_idle_evaluation_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service, "_RETRY_S", 0.01)

    async with application(tmp_path, lease_abort_s=48 * HOUR_S) as http:
        other = expect(await register(http, name="other", track="privileged"), 201)
        headers = {"Authorization": f"Bearer {other['token']}"}
        untouched = expect(await http.post("/v1/evaluations", json={"suite": SUITE}, headers=headers), 201)
        begun = (await begin(http))["id"]
        await drive(http, begun)
        episode = await reset(http, begun)
        http.clock.now += 20 * HOUR_S  # type: ignore[attr-defined]
        expect(await step(http, episode, 1), 200)
        http.clock.now += 5 * HOUR_S  # type: ignore[attr-defined]
        await becomes(http, untouched["id"], "deleted")
        assert await state_of(http, begun) == "running", "its agent took a step five hours ago"
        http.clock.now += 20 * HOUR_S  # type: ignore[attr-defined]
        await becomes(http, begun, "finished")
        problem(await step(http, episode, 2), 409, "episode-finished")
        again = expect(await http.post("/v1/evaluations", json={"suite": SUITE}, headers=headers), 201)
        assert again["commitment"] == untouched["commitment"]


async def test_a_chore_that_fails_keeps_no_other_from_being_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "_RETRY_S", 0.01)

    async def fail(*_: object, **__: object) -> None:
        raise OSError("for good")

    monkeypatch.setattr(Store, "purge", fail)
    monkeypatch.setattr(RunningEvaluations, "retry", fail)

    async with application(tmp_path) as http:
        begun = (await begin(http))["id"]
        await drive(http, begun)
        http.clock.now += 25 * HOUR_S  # type: ignore[attr-defined]
        await becomes(http, begun, "finished")


async def test_a_step_a_day_does_not_keep_an_evaluation_open_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "_RETRY_S", 0.01)

    async with application(tmp_path, lease_abort_s=1000 * HOUR_S) as http:
        begun = (await begin(http))["id"]
        await drive(http, begun)
        episode = await reset(http, begun)
        for day in range(1, 8):
            http.clock.now += 23.5 * HOUR_S  # type: ignore[attr-defined]
            expect(await step(http, episode, day), 200)
            assert await state_of(http, begun) == "running"
        http.clock.now += 4 * HOUR_S  # type: ignore[attr-defined]
        await becomes(http, begun, "finished")


async def test_a_restart_is_no_activity_but_gives_an_hour(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The database's times count. After a start agents get an hour, for the service may have been away for days."""
    monkeypatch.setattr(service, "_RETRY_S", 0.01)

    async with application(tmp_path) as http:
        begun = (await begin(http))["id"]
        await drive(http, begun)
        store = http.app.state.service.store  # type: ignore[attr-defined]
        async with store._database.write() as session:
            for table in ("evaluations", "episodes"):
                await session.execute(text(f"UPDATE {table} SET created = created - 100000"))
            await session.execute(text("UPDATE episodes SET finished = finished - 100000"))
    async with application(tmp_path, registration="operator") as http:
        await asyncio.sleep(0.1)
        assert await state_of(http, begun) == "running"
        http.clock.now += HOUR_S  # type: ignore[attr-defined]
        await becomes(http, begun, "finished")
