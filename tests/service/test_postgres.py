"""What PostgreSQL alone has to be told: durable commits, connections that break, a second service."""

import asyncio
from pathlib import Path

import asyncpg
import pytest
from app_harness import application, step
from fake_pool import FakePool
from postgres_server import PostgresServer, name_of
from service_harness import expect
from sqlalchemy import text
from sqlalchemy.exc import DBAPIError, SQLAlchemyError
from test_storage import agent_row

from wrongturn_service.errors import StartupError
from wrongturn_service.storage import postgres as engine
from wrongturn_service.storage.check import examine
from wrongturn_service.storage.database import Database
from wrongturn_service.storage.store import Store


@pytest.fixture
def url(postgres: PostgresServer) -> str:
    return postgres.new_database()


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine.Ownership.take, "__defaults__", (0.3,))


async def test_a_commit_is_on_the_disk_and_a_read_is_one_snapshot(postgres: PostgresServer, url: str) -> None:
    # A database may say otherwise; the service's word is stronger.
    await asyncio.to_thread(postgres.sql, f"ALTER DATABASE {name_of(url)} SET synchronous_commit = off")

    database = await Database.open(url)
    async with database.write() as session:
        assert await session.scalar(text("SHOW synchronous_commit")) == "on"
        assert await session.scalar(text("SHOW transaction_read_only")) == "off"
    async with database.read() as session:
        assert await session.scalar(text("SHOW transaction_isolation")) == "repeatable read"
        with pytest.raises(DBAPIError, match="read-only"):
            await session.execute(text("DELETE FROM agents"))
    await database.close()


async def test_broken_connections_are_replaced(postgres: PostgresServer, url: str) -> None:
    database = await Database.open(url)
    store = Store(database)
    for number in range(3):
        await store.add_agent(agent_row(f"n{number}"), None)
        assert await asyncio.to_thread(postgres.drop_connections, name_of(url)) >= 2
        assert len(await store.agents()) == number + 1
    await store.add_agent(agent_row("last"), None)
    # The lock went with its connection, and the next write took it again.
    with pytest.raises(StartupError, match="in use by another"):
        await Database.open(url)
    await database.close()


async def test_a_service_that_lost_the_database_to_another_writes_no_more(postgres: PostgresServer, url: str) -> None:
    first = await Database.open(url)
    await asyncio.to_thread(postgres.drop_connections, name_of(url))
    second = await Database.open(url)
    with pytest.raises(engine.DatabaseTakenError):
        await Store(first).add_agent(agent_row("old"), None)
    await Store(second).add_agent(agent_row("new"), None)
    await second.close()
    # Nor when the other is gone: what the first remembers is of the past.
    with pytest.raises(engine.DatabaseTakenError):
        await Store(first).add_agent(agent_row("old"), None)
    assert [row.id for row in await Store(first).agents()] == ["ag_new"]
    await first.close()


async def test_a_lock_that_the_server_has_not_let_go_yet_is_waited_for(postgres: PostgresServer, url: str) -> None:
    """Where a network cuts connections, the server keeps the old one's lock for a while."""
    database = await Database.open(url)
    await asyncio.to_thread(postgres.drop_connections, name_of(url))
    old = await asyncpg.connect(postgres.libpq(name_of(url)))
    assert await old.fetchval(f"SELECT pg_try_advisory_lock({engine.LOCK})")
    with pytest.raises(engine.DatabaseUnreachableError, match="try again"):
        await Store(database).add_agent(agent_row("early"), None)
    await old.close()
    await Store(database).add_agent(agent_row("late"), None)
    assert [row.id for row in await Store(database).agents()] == ["ag_late"]
    await database.close()


async def test_a_new_owner_waits_for_a_write_in_progress(postgres: PostgresServer, url: str) -> None:
    first = await Database.open(url)
    async with first.write() as session:
        session.add(agent_row("slow"))
        await session.flush()
        locks = "SELECT pg_terminate_backend(pid, 60000) FROM pg_locks WHERE locktype = 'advisory' AND database = "
        oid = f"(SELECT oid FROM pg_database WHERE datname = '{name_of(url)}')"
        assert len(await asyncio.to_thread(postgres.sql, locks + oid)) == 1
        second = asyncio.create_task(Database.open(url))
        await asyncio.sleep(0.3)
        assert not second.done()
    taken = await second
    assert [row.id for row in await Store(taken).agents()] == ["ag_slow"]
    await taken.close()
    await first.close()


async def test_a_server_that_is_away_is_told_and_not_a_mistake(postgres: PostgresServer, url: str) -> None:
    database = await Database.open(url)
    name = name_of(url)
    await asyncio.to_thread(postgres.sql, f"ALTER DATABASE {name} WITH ALLOW_CONNECTIONS false")
    await asyncio.to_thread(postgres.drop_connections, name)
    for call in (Store(database).ping(), Store(database).add_agent(agent_row(), None)):
        with pytest.raises(SQLAlchemyError):
            await call
    await asyncio.to_thread(postgres.sql, f"ALTER DATABASE {name} WITH ALLOW_CONNECTIONS true")
    await Store(database).add_agent(agent_row(), None)
    await database.close()


async def test_doctor_tries_the_server(postgres: PostgresServer, url: str, tmp_path: Path) -> None:
    assert "can be used" in await asyncio.to_thread(examine, url, tmp_path)

    database = await Database.open(url)
    assert "in use by a running service" in await asyncio.to_thread(examine, url, tmp_path)
    await database.close()
    assert "can be used" in await asyncio.to_thread(examine, url, tmp_path)
    await asyncio.to_thread(postgres.sql, "UPDATE alembic_version SET version_num = '9999'", name_of(url))
    with pytest.raises(StartupError, match="another version"):
        await asyncio.to_thread(examine, url, tmp_path)
    with pytest.raises(StartupError, match="cannot be used"):
        await asyncio.to_thread(examine, "postgresql://me:secret@127.0.0.1:1/x", tmp_path)


async def test_an_evaluation_goes_on_through_broken_connections(
    postgres: PostgresServer, url: str, tmp_path: Path
) -> None:
    """Whatever is answered by an error is sent again, as a client does; in the end each trial has counted once."""
    async with application(tmp_path, FakePool(), database=url) as http:

        async def call(path: str, body: object = None) -> dict[str, object]:
            for _ in range(400):
                response = await http.post(path, json=body)
                if response.status_code < 500:
                    assert response.is_success, response.text
                    return response.json()
                await asyncio.sleep(0.05)
            raise AssertionError(response.text)

        evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)
        path = f"/v1/evaluations/{evaluation['id']}/episodes"
        for number in range(evaluation["trials"]):
            if number % 2:
                await asyncio.to_thread(postgres.drop_connections, name_of(url))
            episode = (await call(path))["id"]
            for seq in range(1, 10):
                expect(await step(http, str(episode), seq), 200)
            dropped = asyncio.to_thread(postgres.drop_connections, name_of(url))
            last = {"seq": 10, "action": {"steer": 0.0, "throttle": 0.8, "brake": 0.0}}
            _, reply = await asyncio.gather(dropped, call(f"/v1/episodes/{episode}/step", last))
            assert reply["terminated"]
        # The last connection may have broken while the metrics were made. The service makes them again within half
        # a minute, and at once when somebody asks for another trial, as clients do.
        for _ in range(600):
            refused = await http.post(path)
            done = await http.get(f"/v1/evaluations/{evaluation['id']}")
            if refused.status_code == 409 and done.status_code == 200 and done.json()["state"] == "finished":
                break
            await asyncio.sleep(0.1)
        else:
            raise AssertionError(done.text)
        assert refused.json()["type"] == "/problems/evaluation-finished"
        assert done.json()["finished"] == evaluation["trials"]
    name = name_of(url)
    rows = await asyncio.to_thread(
        postgres.sql, "SELECT count(*), count(DISTINCT trial_id) FROM episodes WHERE state = 'finished'", name
    )
    assert tuple(rows[0]) == (evaluation["trials"], evaluation["trials"])
