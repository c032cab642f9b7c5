"""A database of the version before owners, upgraded by the service's start on both engines, and seen through HTTP."""

import time
from pathlib import Path
from typing import Any

import structlog
from alembic import command
from app_harness import application, play
from fake_pool import FakePool
from service_harness import expect, problem
from sqlalchemy import Connection, MetaData, insert, text
from sqlalchemy.ext.asyncio import create_async_engine

from wrongturn_networks import load_suite
from wrongturn_protocol import Leaderboard, Outcome, Trial, Verdict
from wrongturn_service.evaluation import metrics
from wrongturn_service.storage.database import migrations
from wrongturn_service.tokens import digest

AGENTS = {"ag_done": "Done", "ag_begun": "Begun", "ag_like": "WrongTurn", "ag_taken": "wrongturn-2"}
BASELINES = {"ag_base": "Careful"}
OWNERS = AGENTS | {"ag_like": "WrongTurn-3", "ag_base": "Wrongturn"}
"""Each agent's owner afterwards. A stranger cannot have the name of the shipped agents' owner."""
SHOWN = {"registration": "operator"}


def outcome(trial: Trial, verdict: Verdict) -> Outcome:
    reaction = None if trial.fault.kind == "none" else "other"
    return Outcome.model_validate({"verdict": verdict, "reaction": reaction, "time": 1.0, "max_deceleration": 0.0})


def agent(name: str) -> dict[str, Any]:
    shown = (AGENTS | BASELINES)[name]
    words = {"id": name, "name": shown, "name_key": shown.lower(), "token_sha256": digest(name)}
    kind = "baseline" if name in BASELINES else "submitted"
    return {**words, "track": "privileged", "kind": kind, "created": 1.0}


def evaluation(name: str, agent_id: str, suite: str, **more: Any) -> dict[str, Any]:
    found = load_suite(suite)
    row = {"id": name, "agent_id": agent_id, "suite": suite, "suite_sha256": found.sha256, "entry": "remote"}
    return {**row, "state": "running", "secret": name, "trials": len(found.episodes), "created": 2.0, **more}


def episode(name: str, agent_id: str, trial: Trial, of: str | None, end: Outcome | None) -> dict[str, Any]:
    row = {"id": name, "agent_id": agent_id, "evaluation_id": of, "trial_id": trial.id, "track": "privileged"}
    row |= {"trial": trial.model_dump_json(), "created": 3.0, "steps": 7 if end else 0}
    if end is None:
        return {**row, "state": "open"}
    return {**row, "state": "finished", "finished": 4.0, "verdict": end.verdict.value, "outcome": end.model_dump_json()}


def rows() -> dict[str, list[dict[str, Any]]]:
    """A finished evaluation, two that run, one whose metrics were cut off, and practice."""
    draw = load_suite("smoke@1").open_draw
    ends = {trial.id: outcome(trial, Verdict.EXIT_COMMANDED) for trial in draw.episodes}
    told = metrics.compute(draw, ends).model_dump(mode="json")
    del told["unsafe_strict"]["ci83"]  # version 1 had none
    first = draw.trials[0]
    return {
        "agents": [agent(name) for name in (*AGENTS, *BASELINES)],
        "evaluations": [
            evaluation(
                "ev_done",
                "ag_done",
                "smoke@1",
                state="finished",
                finished=5.0,
                metrics=metrics.Metrics.model_validate(told).model_dump_json(),
            ),
            evaluation("ev_begun", "ag_begun", "smoke@1"),
            evaluation("ev_journeys", "ag_begun", "navigation@1"),
            evaluation("ev_cut", "ag_begun", "smoke@1", created=1.0),
        ],
        "episodes": [
            *(
                episode(f"ep_done{n}", "ag_done", trial, "ev_done", ends[trial.id])
                for n, trial in enumerate(draw.episodes)
            ),
            *(
                episode(f"ep_cut{n}", "ag_begun", trial, "ev_cut", ends[trial.id])
                for n, trial in enumerate(draw.episodes)
            ),
            episode("ep_begun", "ag_begun", first, "ev_begun", ends[first.id]),
            episode("ep_open", "ag_begun", draw.trials[1], "ev_begun", None),
            # Practice of more than a week ago is deleted.
            {**episode("ep_practice", "ag_begun", first, None, ends[first.id]), "finished": time.time()},
        ],
    }


def fill(connection: Connection) -> None:
    config = migrations()
    config.attributes["connection"] = connection
    command.upgrade(config, "0002")
    tables = MetaData()
    tables.reflect(connection)
    for table, found in rows().items():
        for row in found:
            connection.execute(insert(tables.tables[table]).values(**row))


async def made(url: str) -> None:
    engine = create_async_engine(url)
    async with engine.begin() as connection:
        await connection.run_sync(fill)
    await engine.dispose()


def test_an_upgraded_database_is_all_there(database_url: str, tmp_path: Path) -> None:
    async def story() -> None:
        await made(database_url)
        with structlog.testing.capture_logs() as said:
            async with application(tmp_path, FakePool(), database=database_url, **SHOWN) as http:
                await seen(http)
        (cancelled,) = [line for line in said if line["event"] == "evaluation cancelled"]
        assert (cancelled["evaluation"], cancelled["log_level"]) == ("ev_begun", "warning")
        # The second start changes nothing.
        async with application(tmp_path, FakePool(), database=database_url, **SHOWN) as http:
            await seen(http)

    async def seen(http: Any) -> None:
        listed = expect(await http.get("/v1/agents?all=true&limit=500"), 200)["agents"]
        assert {one["id"]: one["owner"] for one in listed} == OWNERS
        assert not any(one["trained_on_faults"] for one in listed)
        owners = expect(await http.get("/v1/owners"), 200)["owners"]
        assert sorted(one["name"] for one in owners) == sorted(OWNERS.values())
        done = expect(await http.get("/v1/evaluations/ev_done"), 200)
        assert (done["state"], done["finished"], done["commitment"], done["secret"]) == ("finished", 12, None, None)
        assert expect(await http.get("/v1/episodes/ep_done0"), 200)["outcome"]["verdict"] == "exit_commanded"
        board = Leaderboard.model_validate_json((await http.get("/v1/leaderboards/smoke@1")).text)
        entries = {entry.evaluation: entry for entry in board.entries}
        # All verdicts of the other one were there; the upgrade has computed its metrics.
        assert set(entries) == {"ev_done", "ev_cut"}
        for entry in entries.values():
            assert (entry.rank, entry.eligible) == (None, False)
            assert "version 1" in (entry.why_not or ""), entry.why_not
            assert entry.cancelled == 0
        http.headers["Authorization"] = "Bearer ag_begun"
        states = {
            name: expect(await http.get(f"/v1/evaluations/{name}"), 200)["state"]
            for name in ("ev_begun", "ev_journeys", "ev_cut")
        }
        assert states == {"ev_begun": "cancelled", "ev_journeys": "running", "ev_cut": "finished"}
        assert expect(await http.get("/v1/submissions"), 200) == {"submissions": [], "next": None}
        told = problem(await http.post("/v1/evaluations/ev_begun/episodes"), 409, "evaluation-cancelled")
        assert "smoke@2 replaces smoke@1; begin one on smoke@2" in told["detail"]
        assert expect(await http.get("/v1/episodes/ep_practice"), 200)["outcome"]["verdict"] == "exit_commanded"
        assert expect(await http.get("/v1/episodes/ep_open"), 200)["state"] == "lost"

    play(story)


def test_two_journeys_that_were_open_before_can_both_be_driven(tmp_path: Path) -> None:
    """Version 1 allowed several. The one that was begun first is named when another is asked for."""

    async def story() -> None:
        url = f"sqlite+aiosqlite:///{tmp_path / 'a.db'}"
        await made(url)
        engine = create_async_engine(url)

        def more(connection: Connection) -> None:
            tables = MetaData()
            tables.reflect(connection)
            row = evaluation("ev_later", "ag_begun", "navigation@1", created=9.0)
            connection.execute(insert(tables.tables["evaluations"]).values(**row))

        async with engine.begin() as connection:
            await connection.run_sync(more)
        await engine.dispose()
        async with application(tmp_path, FakePool(), **SHOWN) as http:
            http.headers["Authorization"] = "Bearer ag_begun"
            told = problem(await http.post("/v1/evaluations", json={"suite": "navigation@1"}), 409, "evaluation-open")
            assert told["errors"][0]["message"] == "ev_journeys"
            for name in ("ev_journeys", "ev_later"):
                expect(await http.post(f"/v1/evaluations/{name}/episodes"), 201)

    play(story)


def test_a_stranger_that_has_the_reserved_name_loses_it(database_url: str, tmp_path: Path) -> None:
    """An earlier form of the upgrade gave it away: the agent's owner had the agent's name."""

    async def story() -> None:
        await made(database_url)
        operator = {"Authorization": "Bearer the-operator"}
        words = {**SHOWN, "database": database_url, "operator_token": "the-operator"}
        async with application(tmp_path, FakePool(), **words):
            pass
        engine = create_async_engine(database_url)
        async with engine.begin() as connection:
            await connection.execute(text("UPDATE agents SET owner_id = 'ow_like' WHERE id = 'ag_base'"))
            await connection.execute(text("DELETE FROM owners WHERE name = 'Wrongturn'"))
            await connection.execute(
                text("UPDATE owners SET name = 'WrongTurn', name_key = 'wrongturn' WHERE id = 'ow_like'")
            )
        await engine.dispose()
        for _ in range(2):
            async with application(tmp_path, FakePool(), **words) as http:
                listed = expect(await http.get("/v1/agents?all=true&limit=500"), 200)["agents"]
                assert {one["id"]: one["owner"] for one in listed if one["id"] in OWNERS} == OWNERS
                body = {"name": f"baseline {len(listed)}", "track": "camera", "kind": "baseline"}
                added = expect(await http.post("/v1/agents", json=body, headers=operator), 201)
                assert added["owner"] == "Wrongturn"

    play(story)
