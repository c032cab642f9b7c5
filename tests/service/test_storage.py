"""The database: what cannot be used is named, and nothing is half done."""

import asyncio
import contextlib
import hashlib
import os
import sqlite3
import subprocess
import sys
import zlib
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from sqlalchemy import update
from sqlalchemy.exc import IntegrityError

from wrongturn_service.errors import StartupError
from wrongturn_service.storage.accounts import AgentNameTakenError
from wrongturn_service.storage.database import Database, DatabaseGoneError
from wrongturn_service.storage.episodes import DamagedTrajectoryError
from wrongturn_service.storage.evaluations import EvaluationOverError
from wrongturn_service.storage.models import AgentRow, EpisodeRow, EvaluationRow, OwnerRow, TrajectoryRow
from wrongturn_service.storage.postgres import Ownership
from wrongturn_service.storage.store import Store

FILES = ("a.db", "a.db-shm", "a.db-wal")


def url(path: Path) -> str:
    return f"sqlite+aiosqlite:///{path}"


def agent_row(name: str = "one") -> AgentRow:
    return AgentRow(
        id=f"ag_{name}",
        name=name,
        name_key=name,
        track="state",
        kind="submitted",
        created=1.0,
        owner=OwnerRow(id=f"ow_{name}", name=name, name_key=name, created=1.0),
    )


@pytest.mark.parametrize(
    ("database", "message"),
    [
        ("sqlite+aiosqlite:////proc/wrongturn.db", "cannot be written"),
        ("sqlite+aiosqlite:////dev/null/wrongturn.db", "there is no folder /dev/null for"),
        ("sqlite+aiosqlite:///{folder}/none/wrongturn.db", "there is no folder .*/none for the database file; make it"),
        ("sqlite+aiosqlite:///{folder}", "Is a directory"),
        ("sqlite+aiosqlite:///{folder}/text.db", "file is not a database"),
        ("sqlite+aiosqlite://", "has to be a file"),
        ("sqlite+aiosqlite:///:memory:", "has to be a file"),
        ("sqlite+aiosqlite:///{folder}/newer.db", "made by another version of Wrongturn .*; use that version, or name"),
        ("nonsense", "is not a database URL"),
        ("oracle://x", "cannot be used"),
        ("postgresql://me:secret@127.0.0.1:1/x", r"postgresql\+asyncpg://me:\*\*\*@127.0.0.1:1/x cannot be used"),
        ("nothing+at_all://x", "no driver"),
    ],
)
async def test_a_database_that_cannot_be_used(tmp_path: Path, database: str, message: str) -> None:
    (tmp_path / "text.db").write_text("no database, but long enough to be taken for one\n" * 50)
    newer = sqlite3.connect(tmp_path / "newer.db")
    newer.executescript(
        "CREATE TABLE alembic_version (version_num VARCHAR(32)); INSERT INTO alembic_version VALUES ('9999')"
    )
    newer.close()
    with pytest.raises(StartupError, match=message):
        await Database.open(database.format(folder=tmp_path))


async def test_no_folder_is_made_but_the_home(tmp_path: Path) -> None:
    home = tmp_path / "new" / "home"
    for folder in (tmp_path / "slip", home / "deeper", home.parent):
        with pytest.raises(StartupError, match="there is no folder"):
            await Database.open(url(folder / "a.db"), home=home)
    assert not home.parent.exists()
    await (await Database.open(url(home / "a.db"), home=home)).close()
    assert (home / "a.db").exists()


async def test_two_services_cannot_share_a_database(database_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Ownership.take, "__defaults__", (0.3,))

    first = await Database.open(database_url)
    with pytest.raises(StartupError, match="in use by another"):
        await Database.open(database_url)
    await first.close()
    await (await Database.open(database_url)).close()


def refusals(*names: Path) -> str:
    """What a second service says of each file, in a process of its own: a closed file would end SQLite's locks here."""
    program = "import asyncio, sys; from wrongturn_service.storage.database import Database\n"
    program += "for url in sys.argv[1:]:\n    try: asyncio.run(Database.open(url))\n    except Exception as e: print(e)"
    command = [sys.executable, "-c", program, *map(url, names)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


async def test_a_file_has_one_service_under_each_of_its_names(tmp_path: Path) -> None:
    file, moved, other = tmp_path / "a.db", tmp_path / "moved.db", tmp_path / "other"
    other.mkdir()
    symbolic, hard = other / "symbolic.db", other / "hard.db"

    first = await Database.open(url(file))
    # No other file holds the lock, so nobody can delete it.
    assert (await asyncio.to_thread(_modes, tmp_path)).keys() == {*FILES, "other"}
    symbolic.symlink_to(file)
    hard.hardlink_to(file)
    said = await asyncio.to_thread(refusals, file, symbolic, hard)
    assert said.count("is in use by another Wrongturn service") == 3, said
    file.rename(moved)
    assert "is in use by another" in await asyncio.to_thread(refusals, moved)
    with pytest.raises(DatabaseGoneError, match="put it back or restart"):
        first.check()
    moved.rename(file)
    first.check()
    await first.close()


async def test_the_promises_of_a_commit(tmp_path: Path) -> None:
    database = await Database.open(url(tmp_path / "a.db"))
    async with database.read() as session:
        connection = await session.connection()
        names = ("journal_mode", "synchronous", "foreign_keys")
        promised = [(await connection.exec_driver_sql(f"PRAGMA {name}")).scalar() for name in names]
    await database.close()
    full = 2
    assert promised == ["wal", full, 1]


def _modes(folder: Path) -> dict[str, int]:
    return {file.name: file.stat().st_mode & 0o777 for file in folder.iterdir()}


@pytest.mark.parametrize("mode", [0o600, 0o640])
async def test_the_file_is_for_its_owner_alone_or_has_the_mode_that_it_had(tmp_path: Path, mode: int) -> None:
    before = os.umask(0o022)
    try:
        if mode != 0o600:
            (tmp_path / "a.db").touch(mode)
        database = await Database.open(url(tmp_path / "a.db"))
        async with database.write() as session:
            session.add(agent_row())
        assert await asyncio.to_thread(_modes, tmp_path) == dict.fromkeys(FILES, mode)
        await database.close()
    finally:
        os.umask(before)


async def half(database: Database) -> None:
    async with database.write() as session:
        session.add(agent_row("two"))
        await session.flush()
        session.add(TrajectoryRow(episode_id="none", sha256="", size=0, data=b""))


async def test_a_transaction_is_whole_or_not_at_all(database_url: str) -> None:
    database = await Database.open(database_url)
    store = Store(database)
    await store.add_agent(agent_row(), None)
    with pytest.raises(AgentNameTakenError):
        await store.add_agent(agent_row(), None)
    with pytest.raises(IntegrityError):
        await half(database)
    assert [row.id for row in await store.agents()] == ["ag_one"]
    await database.close()


def evaluation_row(agent: str = "ag_one") -> EvaluationRow:
    return EvaluationRow(
        id="ev",
        agent_id=agent,
        suite="s@1",
        suite_sha256="0",
        entry="remote",
        state="running",
        secret="x",
        trials=2,
        created=1.0,
    )


def episode_row(name: str, trial: str, evaluation: str | None = "ev") -> EpisodeRow:
    return EpisodeRow(
        id=name,
        evaluation_id=evaluation,
        agent_id="ag_one",
        trial_id=trial,
        trial="{}",
        track="state",
        state="open",
        created=1.0,
        steps=0,
    )


@contextlib.asynccontextmanager
async def filled(url: str) -> AsyncIterator[tuple[Database, Store]]:
    """A store with an agent and its evaluation."""
    database = await Database.open(url)
    try:
        store = Store(database)
        await store.add_agent(agent_row(), None)
        await store.begin_evaluation(evaluation_row(), lambda _: None)
        yield database, store
    finally:
        await database.close()


TRAJECTORY = b'{"rows":[]}' * 1000
SHA256 = hashlib.sha256(TRAJECTORY).hexdigest()


async def test_an_episode_has_one_end(sqlite_url: str) -> None:
    async with filled(sqlite_url) as (_, store):
        for name in ("a", "b"):
            await store.add_episode(episode_row(name, name), None)
        end = {"verdict": "timeout", "steps": 3}
        assert await store.finish_episode("a", end, TRAJECTORY, SHA256)
        assert await store.finish_episode("a", end, TRAJECTORY, SHA256), "the same end again"
        assert not await store.finish_episode("a", {"verdict": "collision", "steps": 4}, b"other", "00")
        assert await store.trajectory("a") == (TRAJECTORY, SHA256)
        assert await store.lose_open_episodes() == 1
        assert not await store.finish_episode("b", {"verdict": "timeout"}, b"", "")
        assert await store.finished_count("ev") == 1


async def test_a_trial_counts_once(database_url: str) -> None:
    async with filled(database_url) as (database, store):
        await store.add_episode(episode_row("unheard", "t"), None)
        await store.add_episode(episode_row("heard", "t"), None)
        ghost = await store.episode("unheard")
        assert ghost is not None
        assert ghost.state == "lost"
        assert await store.finish_episode("heard", {"verdict": "timeout"}, b"", "")
        with pytest.raises(EvaluationOverError):
            await store.add_episode(episode_row("again", "t"), None)
        with pytest.raises(IntegrityError):
            async with database.write() as session:
                await session.execute(update(EpisodeRow).values(state="finished"))
        assert await store.finished_count("ev") == 1
        for name in ("p", "q"):  # practice has no such limit
            await store.add_episode(episode_row(name, "t", None), None)


async def test_a_damaged_trajectory_is_not_handed_out(sqlite_url: str) -> None:
    async with filled(sqlite_url) as (database, store):
        for name, data in (("a", zlib.compress(b"another")), ("b", b"noise")):
            await store.add_episode(episode_row(name, name), None)
            assert await store.finish_episode(name, {"verdict": "timeout"}, TRAJECTORY, SHA256)
            async with database.write() as session:
                await session.execute(update(TrajectoryRow).where(TrajectoryRow.episode_id == name).values(data=data))
            with pytest.raises(DamagedTrajectoryError, match=f"trajectory of {name}"):
                await store.trajectory(name)


async def test_many_at_once(database_url: str) -> None:
    async with filled(database_url) as (_, store):
        names = [f"e{number}" for number in range(20)]
        await asyncio.gather(*(store.add_episode(episode_row(name, name), None) for name in names))
        stored = await asyncio.gather(
            *(store.finish_episode(name, {"verdict": "timeout"}, TRAJECTORY, SHA256) for name in names * 3),
            *(store.put_results("ev", "{}") for _ in range(5)),
            *(store.trials_by_state("ev") for _ in range(10)),
        )
        assert all(stored[:60])
        assert await store.finished_count("ev") == 20
