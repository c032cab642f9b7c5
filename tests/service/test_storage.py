"""The database: what cannot be used is named, migrations make what the models say, and nothing is half done."""

import asyncio
import sqlite3
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import Connection
from sqlalchemy.exc import IntegrityError

from wrongturn_service.errors import StartupError
from wrongturn_service.storage.database import Database
from wrongturn_service.storage.models import AgentRow, Base, EpisodeRow, EvaluationRow, TrajectoryRow
from wrongturn_service.storage.store import NameTakenError, Store


def url(path: Path) -> str:
    return f"sqlite+aiosqlite:///{path}"


def agent_row(name: str = "one") -> AgentRow:
    return AgentRow(id=f"ag_{name}", name=name, name_key=name, track="state", kind="submitted", created=1.0)


@pytest.mark.parametrize(
    ("database", "message"),
    [
        ("sqlite+aiosqlite:////proc/wrongturn.db", "cannot be written"),
        ("sqlite+aiosqlite:////dev/null/wrongturn.db", "there is no folder /dev/null for"),
        ("sqlite+aiosqlite:///{folder}/none/wrongturn.db", "there is no folder .*/none for the database file; make it"),
        ("sqlite+aiosqlite:///{folder}", "unable to open database file"),
        ("sqlite+aiosqlite:///{folder}/text.db", "file is not a database"),
        ("sqlite+aiosqlite://", "has to be a file"),
        ("sqlite+aiosqlite:///:memory:", "has to be a file"),
        ("sqlite+aiosqlite:///{folder}/newer.db", "another version"),
        ("nonsense", "is none"),
        ("oracle://x", "cannot be used"),
        ("nothing+at_all://x", "no driver"),
    ],
)
def test_a_database_that_cannot_be_used(tmp_path: Path, database: str, message: str) -> None:
    (tmp_path / "text.db").write_text("no database, but long enough to be taken for one\n" * 50)
    newer = sqlite3.connect(tmp_path / "newer.db")
    newer.executescript(
        "CREATE TABLE alembic_version (version_num VARCHAR(32)); INSERT INTO alembic_version VALUES ('9999')",
    )
    newer.close()
    with pytest.raises(StartupError, match=message):
        asyncio.run(Database.open(database.format(folder=tmp_path)))


def test_no_folder_is_made_but_the_home(tmp_path: Path) -> None:
    home = tmp_path / "new" / "home"
    for folder in (tmp_path / "slip", home / "deeper", home.parent):
        with pytest.raises(StartupError, match="there is no folder"):
            asyncio.run(Database.open(url(folder / "a.db"), home=home))
    assert not list(tmp_path.iterdir())

    async def story() -> None:
        await (await Database.open(url(home / "a.db"), home=home)).close()

    asyncio.run(story())
    assert (home / "a.db").exists()


def test_two_services_cannot_share_a_file(tmp_path: Path) -> None:
    async def story() -> None:
        first = await Database.open(url(tmp_path / "a.db"))
        with pytest.raises(StartupError, match="in use by another"):
            await Database.open(url(tmp_path / "a.db"))
        await first.close()
        await (await Database.open(url(tmp_path / "a.db"))).close()

    asyncio.run(story())


def test_migrations_make_what_the_models_say(tmp_path: Path) -> None:
    def differences(connection: Connection) -> list[object]:
        return compare_metadata(MigrationContext.configure(connection), Base.metadata)

    async def story() -> list[object]:
        database = await Database.open(url(tmp_path / "a.db"))
        try:
            async with database.read() as session:
                return await (await session.connection()).run_sync(differences)
        finally:
            await database.close()

    assert asyncio.run(story()) == []


def test_the_promises_of_a_commit(tmp_path: Path) -> None:
    async def story() -> list[object]:
        database = await Database.open(url(tmp_path / "a.db"))
        try:
            async with database.read() as session:
                connection = await session.connection()
                names = ("journal_mode", "synchronous", "foreign_keys")
                return [(await connection.exec_driver_sql(f"PRAGMA {name}")).scalar() for name in names]
        finally:
            await database.close()

    full = 2
    assert asyncio.run(story()) == ["wal", full, 1]


async def half(database: Database) -> None:
    async with database.write() as session:
        session.add(agent_row("two"))
        await session.flush()
        session.add(TrajectoryRow(episode_id="none", sha256="", size=0, data=b""))


def test_a_transaction_is_whole_or_not_at_all(tmp_path: Path) -> None:
    async def story() -> None:
        database = await Database.open(url(tmp_path / "a.db"))
        store = Store(database)
        await store.add_agent(agent_row(), None)
        with pytest.raises(NameTakenError):
            await store.add_agent(agent_row(), None)
        with pytest.raises(IntegrityError):
            await half(database)
        assert [row.id for row in await store.agents()] == ["ag_one"]
        await database.close()

    asyncio.run(story())


def test_an_episode_has_one_end(tmp_path: Path) -> None:
    async def story() -> None:
        database = await Database.open(url(tmp_path / "a.db"))
        store = Store(database)
        await store.add_agent(agent_row(), None)
        evaluation = EvaluationRow(
            id="ev",
            agent_id="ag_one",
            suite="s@1",
            suite_sha256="0",
            entry="remote",
            state="running",
            secret="x",
            trials=2,
            created=1.0,
        )
        await store.add_evaluation(evaluation, None)
        for name in ("a", "b"):
            row = EpisodeRow(
                id=name,
                evaluation_id="ev",
                agent_id="ag_one",
                trial_id=name,
                trial="{}",
                track="state",
                state="open",
                created=1.0,
                steps=0,
            )
            await store.add_episode(row, None)
        trajectory = b'{"rows":[]}' * 1000
        assert await store.finish_episode("a", {"verdict": "timeout", "steps": 3}, trajectory, "ff")
        assert not await store.finish_episode("a", {"verdict": "collision", "steps": 4}, b"other", "00")
        assert await store.trajectory("a") == (trajectory, "ff")
        assert await store.lose_open_episodes() == 1
        assert not await store.finish_episode("b", {"verdict": "timeout"}, b"", "")
        assert await store.finished_count("ev") == 1
        await database.close()

    asyncio.run(story())
