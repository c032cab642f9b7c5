"""Backups each night, and a new machine that goes on with one of them: what docs/operating.md says."""

import asyncio
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from app_harness import application, register, step
from fake_pool import FakePool
from postgres_server import PostgresServer, programs
from service_harness import expect, problem

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/operating.md").read_text("utf-8")
BACKUP = ROOT / "deploy/backup"
BOARD = "/v1/leaderboards/smoke@3"


def machine(home: Path, database: str) -> dict[str, str]:
    """The environment of the commands on a machine."""
    path = os.pathsep.join([str(Path(sys.executable).parent), str(programs()), os.environ["PATH"]])
    kept = {name: value for name, value in os.environ.items() if not name.startswith("WRONGTURN_")}
    return {**kept, "PATH": path, "WRONGTURN_HOME": str(home), "WRONGTURN_DATABASE": database}


def run(*command: object, **options: object) -> str:
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False, **options)  # type: ignore[call-overload]
    assert done.returncode == 0, done.stdout + done.stderr
    return str(done.stdout)


@dataclass(frozen=True)
class Left:
    """What the old machine had when its backup was made."""

    board: dict[str, Any]
    first: str
    """``Authorization`` of the agent on the board."""
    token: str
    running: str
    """Evaluation of which the other agent had driven three episodes."""
    open_one: str
    """The episode that was open."""


async def drive(http: httpx.AsyncClient, evaluation: str, episodes: int) -> None:
    for _ in range(episodes):
        episode = expect(await http.post(f"/v1/evaluations/{evaluation}/episodes"), 201)["id"]
        for seq in range(1, 11):
            expect(await step(http, episode, seq), 200)


@pytest.mark.parametrize("engine", [pytest.param("sqlite", marks=pytest.mark.soak), "postgresql"])
async def test_a_new_machine_goes_on_with_a_backup(engine: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    homes = [tmp_path / name for name in ("old", "new")]
    for home in homes:
        home.mkdir()
    databases = [f"sqlite+aiosqlite:///{home / 'wrongturn.db'}" for home in homes]
    if engine == "postgresql":
        server: PostgresServer = request.getfixturevalue("postgres")
        databases = [await asyncio.to_thread(server.new_database) for _ in homes]
    backups = tmp_path / "backups"

    async def old(http: httpx.AsyncClient) -> Left:
        first = str(http.headers["Authorization"])
        done = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
        await drive(http, done, 12)
        token = expect(await register(http, name="two", track="camera"), 201)["token"]
        http.headers["Authorization"] = f"Bearer {token}"
        running = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
        await drive(http, running, 3)
        open_one = expect(await http.post(f"/v1/evaluations/{running}/episodes"), 201)["id"]
        board = expect(await http.get(BOARD), 200)
        await asyncio.to_thread(run, BACKUP, backups, 14, env=machine(homes[0], databases[0]))
        await drive(http, running, 1)  # comes too late for the backup
        return Left(board, first, token, running, open_one)

    async def new(http: httpx.AsyncClient, left: Left) -> None:
        assert expect(await http.get(BOARD), 200) == left.board
        http.headers["Authorization"] = left.first
        problem(await http.get(f"/v1/evaluations/{left.running}"), 403, "forbidden")
        http.headers["Authorization"] = f"Bearer {left.token}"
        assert expect(await http.get(f"/v1/evaluations/{left.running}"), 200)["finished"] == 3
        problem(await step(http, left.open_one, 1), 410, "episode-lost")
        await drive(http, left.running, 9)
        assert expect(await http.get(f"/v1/evaluations/{left.running}"), 200)["state"] == "finished"

    async with application(homes[0], FakePool(), database=databases[0]) as http:
        left = await old(http)
    (file,) = backups.iterdir()
    run("wrongturn", "restore", "--yes", file, env=machine(homes[1], databases[1]))
    async with application(homes[1], FakePool(), database=databases[1], registration="operator") as http:
        await new(http, left)


def test_the_newest_backups_stay_and_are_their_owners_alone(tmp_path: Path) -> None:
    folder = tmp_path / "backups"
    folder.mkdir()
    others = ["wrongturn-2020-01-01T00-00-00Z.backup", "wrongturn-2020-01-02T00-00-00Z.backup", "notes.txt"]
    for name in others:
        (folder / name).write_text("old")
    new = Path(run(BACKUP, folder, 2, "printf", "a backup").strip())
    assert sorted(path.name for path in folder.iterdir()) == sorted([*others[1:], new.name])
    assert new.read_text() == "a backup"
    assert new.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (("2", "sh", "-c", "printf half; exit 3"), 3, ""),
        (("2", "true"), 1, "'true' wrote nothing"),
        (("0",), 2, "KEEP is how many backups stay, at least 1"),
        (("two",), 2, "usage: backup FOLDER KEEP"),
        ((), 2, "usage: backup FOLDER KEEP"),
    ],
)
def test_a_backup_that_fails_leaves_the_older_ones(
    tmp_path: Path, arguments: tuple[str, ...], status: int, said: str
) -> None:
    older = [tmp_path / f"wrongturn-2020-01-0{day}T00-00-00Z.backup" for day in (1, 2, 3)]
    for path in older:
        path.write_text("old")
    done = subprocess.run([str(BACKUP), str(tmp_path), *arguments], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (status, "")
    assert said in done.stderr
    assert sorted(tmp_path.iterdir()) == older


def test_the_units_of_systemd(tmp_path: Path) -> None:
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("there is no systemd-analyze; apt-get install systemd")
    program = tmp_path / "program"
    program.symlink_to("/bin/true")
    units = sorted((ROOT / "deploy").glob("wrongturn*.*"))
    for unit in units:
        # Programs that are not on this machine are no fault of the unit.
        text = re.sub(r"^(ExecStart=)\S+", rf"\1{program}", unit.read_text("utf-8"), flags=re.MULTILINE)
        (tmp_path / unit.name).write_text(text)
    run(analyze, "verify", "--man=no", *(tmp_path / unit.name for unit in units))
    assert [unit.name for unit in units] == ["wrongturn-backup.service", "wrongturn-backup.timer", "wrongturn.service"]
    for unit in units[:2]:
        assert unit.name in PAGE
