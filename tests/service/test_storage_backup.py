"""A backup made under load can be put back, and has all that was acknowledged before it was begun."""

import asyncio
import os
from pathlib import Path

import pytest
import typer
from postgres_server import programs
from test_storage import SHA256, TRAJECTORY, episode_row, filled
from typer.testing import CliRunner

from wrongturn_service.backup_cli import backup, restore
from wrongturn_service.errors import StartupError
from wrongturn_service.storage.backup import back_up
from wrongturn_service.storage.backup import restore as put_back
from wrongturn_service.storage.database import Database
from wrongturn_service.storage.store import Store

app = typer.Typer()
app.command()(backup)
app.command()(restore)


@pytest.fixture(autouse=True)
def _client_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", f"{programs()}{os.pathsep}{os.environ['PATH']}")


async def finish(store: Store, number: int) -> None:
    await store.add_episode(episode_row(f"e{number}", f"t{number}"), None)
    assert await store.finish_episode(f"e{number}", {"verdict": "timeout"}, TRAJECTORY, SHA256)


async def test_a_backup_under_load_and_back(database_url: str, tmp_path: Path) -> None:
    file = tmp_path / "backup"

    async with filled(database_url) as (_, store):
        for number in range(10):
            await finish(store, number)
        later = asyncio.gather(*(finish(store, number) for number in range(10, 30)))
        await asyncio.to_thread(back_up, database_url, file)
        await later
        with pytest.raises(StartupError, match=r"uses the database|in use by another"):
            await asyncio.to_thread(put_back, database_url, file, tmp_path)
        assert await store.finished_count("ev") == 30
    await asyncio.to_thread(put_back, database_url, file, tmp_path)
    database = await Database.open(database_url)
    store = Store(database)
    count = await store.finished_count("ev")
    assert 10 <= count <= 30
    assert await store.trajectory("e9") == (TRAJECTORY, SHA256)
    # A half of an episode's end is in no backup.
    finished = [row.id for row in await store.episodes("ev") if row.state == "finished"]
    assert len(finished) == count
    for name in finished:
        assert await store.trajectory(name) is not None
    await store.lose_open_episodes()
    await finish(store, 99)
    await database.close()
    assert file.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize("mode", [None, 0o640])
async def test_what_is_put_back_is_its_owners_or_as_it_was(tmp_path: Path, mode: int | None) -> None:
    first, second = tmp_path / "a.db", tmp_path / "b.db"
    await (await Database.open(f"sqlite+aiosqlite:///{first}")).close()
    back_up(f"sqlite+aiosqlite:///{first}", tmp_path / "backup")
    if mode is not None:
        second.touch()
        second.chmod(mode)
    put_back(f"sqlite+aiosqlite:///{second}", tmp_path / "backup", tmp_path)
    assert second.stat().st_mode & 0o777 == (mode or 0o600)


def test_what_cannot_be(tmp_path: Path) -> None:
    url = f"sqlite+aiosqlite:///{tmp_path / 'a.db'}"
    (tmp_path / "text").write_text("no database\n" * 100)
    with pytest.raises(StartupError, match="cannot be copied"):
        back_up(url, tmp_path / "b")
    with pytest.raises(StartupError, match="already exists"):
        back_up(url, tmp_path / "text")
    with pytest.raises(StartupError, match="there is no folder"):
        back_up(url, tmp_path / "none" / "b")
    with pytest.raises(StartupError, match="there is no backup"):
        put_back(url, tmp_path / "b", tmp_path)
    with pytest.raises(StartupError, match="cannot be copied"):
        put_back(url, tmp_path / "text", tmp_path)
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {"text"}


def test_without_client_programs_the_command_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(StartupError, match=r"pg_dump --format=custom .*postgresql://me@host/name") as told:
        back_up("postgresql://me:secret@host/name", tmp_path / "b")
    assert "secret" not in str(told.value)


async def test_the_commands(tmp_path: Path) -> None:
    url = f"sqlite+aiosqlite:///{tmp_path / 'a.db'}"

    async with filled(url):
        pass
    runner = CliRunner()
    file = str(tmp_path / "b")
    assert runner.invoke(app, ["backup", file, "--database", url]).exit_code == 0
    assert runner.invoke(app, ["backup", file, "--database", url]).exit_code == 1
    (tmp_path / "a.db").unlink()
    assert runner.invoke(app, ["restore", file, "--database", url], input="n\n").exit_code == 1
    assert not (tmp_path / "a.db").exists()
    assert runner.invoke(app, ["restore", file, "--database", url, "--yes"]).exit_code == 0
    assert (tmp_path / "a.db").exists()


async def test_a_backup_goes_through_streams(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "home"
    monkeypatch.setenv("WRONGTURN_HOME", str(home))
    url = f"sqlite+aiosqlite:///{tmp_path / 'a.db'}"
    runner = CliRunner()
    none = runner.invoke(app, ["backup", "-", "--database", url])
    assert (none.exit_code, none.stdout_bytes) == (1, b"")

    async with filled(url):
        pass
    made = runner.invoke(app, ["backup", "-", "--database", url])
    assert made.exit_code == 0
    assert made.stdout_bytes.startswith(b"SQLite format 3")
    before = (tmp_path / "a.db").read_bytes()
    (tmp_path / "a.db").unlink()
    assert runner.invoke(app, ["restore", "-", "--database", url], input=made.stdout_bytes).exit_code == 2
    assert runner.invoke(app, ["restore", "-", "--database", url, "--yes"], input=b"no backup").exit_code == 1
    assert runner.invoke(app, ["restore", "-", "--database", url, "--yes"], input=made.stdout_bytes).exit_code == 0
    assert (tmp_path / "a.db").stat().st_size == len(before)
    # Nothing is left behind.
    assert not list(home.iterdir())
