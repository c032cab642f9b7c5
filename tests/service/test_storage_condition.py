"""A database that fails while the service runs: readiness, replies and metrics say so, and nothing is lost."""

import asyncio
import resource
import sqlite3
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
from app_harness import application, register
from fake_pool import FakePool
from postgres_server import PostgresServer, name_of
from service_harness import GAS, RunningService, expect, problem
from sqlalchemy.exc import OperationalError
from test_metrics import figures

from wrongturn_service.errors import StartupError
from wrongturn_service.storage import database as databases
from wrongturn_service.storage.condition import Condition, FailureKind, kind_of, kind_of_state
from wrongturn_service.storage.database import Database, DatabaseGoneError


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(databases, "_PROBE_EVERY_S", 0.05)


@pytest.fixture
def running(tmp_path: Path) -> Iterator[RunningService]:
    service = RunningService(tmp_path / "wrongturn.db", simulators=1)
    assert service.ready, service.stderr
    try:
        yield service
    finally:
        service.stop()


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < deadline, "it has not happened within two minutes"
        time.sleep(0.05)


def test_a_disk_that_takes_no_more(running: RunningService) -> None:
    """Every write to a file fails, as on a broken disk, while an agent drives."""
    limits = resource.prlimit(running.process.pid, resource.RLIMIT_FSIZE)
    with running.agent() as agent, httpx.Client(base_url=running.url, timeout=60) as http:
        episode = agent.practise()["id"]
        evaluation = agent.evaluate()["id"]
        expect(http.get("/health/ready"), 200)
        resource.prlimit(running.process.pid, resource.RLIMIT_FSIZE, (0, limits[1]))
        seq = 1
        while (reply := agent.step(episode, seq)).status_code == 200:
            seq += 1
        assert seq > 1, "steps before the last write nothing"
        body = {"name": "late", "track": "camera"}
        for refused in (reply, agent.reset(evaluation), http.post("/v1/agents", json=body), http.get("/health/ready")):
            problem(refused, 503, "storage-failed")
            assert int(refused.headers["Retry-After"]) >= 1
        assert "its disk or file system fails" in http.get("/health/ready").json()["detail"]
        expect(agent.http.get(f"/v1/evaluations/{evaluation}"), 200)
        metrics = http.get("/metrics").text
        assert "\nwrongturn_ready 0.0\n" in metrics
        assert 'wrongturn_storage_errors_total{kind="io"} 0.0' not in metrics
        resource.prlimit(running.process.pid, resource.RLIMIT_FSIZE, limits)
        # Nobody writes, but the service finds out.
        wait_for(lambda: http.get("/health/ready").status_code == 200)
        assert "\nwrongturn_ready 1.0\n" in http.get("/metrics").text
        final = expect(agent.step(episode, seq, GAS), 200)
        assert final["terminated"] or final["truncated"]
        assert agent.trajectory(episode)
        expect(http.post("/v1/agents", json=body), 201)
        expect(agent.reset(evaluation), 201)
    assert '"event": "the database fails"' in running.stderr
    assert '"event": "the database works again"' in running.stderr


async def test_a_server_that_becomes_read_only(postgres: PostgresServer, tmp_path: Path) -> None:
    url = await asyncio.to_thread(postgres.new_database)

    def set_up(words: str) -> None:
        postgres.sql(f"ALTER DATABASE {name_of(url)} {words}")
        postgres.drop_connections(name_of(url))

    async with application(tmp_path, FakePool(), database=url) as http:
        await asyncio.to_thread(set_up, "SET default_transaction_read_only = on")
        problem(await register(http, name="two", track="camera"), 503, "storage-failed")
        told = problem(await http.get("/health/ready"), 503, "storage-failed")
        assert told["detail"] == "the database fails: it is read-only"
        found = await figures(http)
        assert found["wrongturn_ready"] == 0
        assert found["wrongturn_storage_errors_total,read-only"] >= 1
        await asyncio.to_thread(set_up, "RESET default_transaction_read_only")
        while (await http.get("/health/ready")).status_code != 200:  # noqa: ASYNC110 - nobody tells of it
            await asyncio.sleep(0.05)
        expect(await register(http, name="two", track="camera"), 201)
        found = await figures(http)
        assert found["wrongturn_ready"] == 1
        assert found["wrongturn_database_seconds_count,write"] >= 3


async def test_a_write_that_does_not_end(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    database = await Database.open(f"sqlite+aiosqlite:///{tmp_path / 'a.db'}")
    async with database.write():
        assert database.condition.trouble is None
        monkeypatch.setattr("wrongturn_service.storage.condition.STUCK_S", 0.0)
        assert "a write has not ended" in (database.condition.trouble or "")
    assert database.condition.trouble is None
    await database.close()


def test_what_sqlite_says(tmp_path: Path) -> None:
    def error_of(statement: str, path: str = ":memory:") -> FailureKind | None:
        connection = sqlite3.connect(path, uri=True)
        connection.execute("PRAGMA max_page_count = 1")
        try:
            connection.execute(statement)
        except sqlite3.Error as error:
            return kind_of(OperationalError(statement, {}, error))
        finally:
            connection.close()
        return None

    sqlite3.connect(tmp_path / "a.db").close()
    assert error_of("CREATE TABLE t (x)") is FailureKind.FULL
    assert error_of("CREATE TABLE t (x)", f"file:{tmp_path}/a.db?mode=ro") is FailureKind.READ_ONLY
    assert error_of("SELECT no_such_column") is FailureKind.OTHER


@pytest.mark.parametrize(
    ("state", "kind"),
    [("53100", FailureKind.FULL), ("57P01", FailureKind.UNREACHABLE), ("XX001", FailureKind.DAMAGED), ("22021", None)],
)
def test_what_postgresql_says(state: str, kind: FailureKind | None) -> None:
    assert kind_of_state(state) is kind


def test_what_a_caller_sent_is_no_failure() -> None:
    condition = Condition()
    condition.failed(OperationalError("SELECT x", {}, sqlite3.OperationalError("no such column")))
    assert condition.trouble is None
    condition.failed(DatabaseGoneError("gone"))
    assert condition.trouble == "its file was deleted, moved or replaced"
    condition.wrote()
    assert condition.trouble is None


async def test_a_file_that_is_moved_away(tmp_path: Path) -> None:
    """Whoever is the first to notice hears what everybody hears, and nobody begins a new file beside the log."""
    async with application(tmp_path, FakePool()) as http:
        file = (tmp_path / "a.db").rename(tmp_path / "moved.db")
        for _ in range(2):
            told = problem(await http.get("/health/ready"), 503, "storage-failed")
            assert told["detail"] == "the database fails: its file was deleted, moved or replaced"
            problem(await register(http, name="late", track="camera"), 503, "storage-failed")
            (tmp_path / "a.db").write_bytes(b"")  # another of the name is none either
        (tmp_path / "a.db").unlink()
        with pytest.raises(StartupError, match=r"a\.db was deleted or moved, but .*a\.db-wal is there: a service"):
            await Database.open(f"sqlite+aiosqlite:///{tmp_path / 'a.db'}")
        file.rename(tmp_path / "a.db")
        while (await http.get("/health/ready")).status_code != 200:  # noqa: ASYNC110 - nobody tells of it
            await asyncio.sleep(0.05)
