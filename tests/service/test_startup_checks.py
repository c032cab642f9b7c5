"""What ``wrongturn doctor`` finds of the database, and which addresses are refused."""

import asyncio
import itertools
import os
import re
import socket
import sys
from pathlib import Path

import pytest
import structlog

from wrongturn_service import cli, server
from wrongturn_service.address import AddressError, bind
from wrongturn_service.settings import PREFIX, Settings
from wrongturn_service.simulators import check
from wrongturn_service.simulators.local_simulator import LocalStarter
from wrongturn_service.storage.database import Database


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in Settings.model_fields:
        monkeypatch.delenv(PREFIX + name.upper(), raising=False)
    home = tmp_path / "home"
    monkeypatch.setenv("WRONGTURN_HOME", str(home))
    return home


def finding(database: str | None = None) -> tuple[bool, str, str]:
    with pytest.MonkeyPatch.context() as patch:
        if database is not None:
            patch.setenv("WRONGTURN_DATABASE", database)
        _, (name, ok, detail, remedy) = itertools.islice(cli.checks(), 2)
    assert name == "database"
    return ok, detail, remedy


def url(file: Path) -> str:
    return f"sqlite+aiosqlite:///{file}"


def test_a_database_that_is_not_there_yet(home: Path, tmp_path: Path) -> None:
    assert finding() == (True, f"{home}/wrongturn.db can be created", "")
    assert finding(url(tmp_path / "a.db")) == (True, f"{tmp_path}/a.db can be created", "")
    assert not list(home.iterdir())


def test_a_database_that_is_there_stays_as_it_is(tmp_path: Path) -> None:
    file = tmp_path / "a.db"

    async def story() -> None:
        database = await Database.open(url(file))
        ok, detail, _ = await asyncio.to_thread(finding, url(file))
        assert ok
        assert detail == f"{file} is in use by a running service"
        await database.close()

    asyncio.run(story())
    before = file.read_bytes()
    assert finding(url(file)) == (True, f"{file} can be used", "")
    assert file.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["a.db"]


def test_a_database_that_the_service_could_not_use(tmp_path: Path) -> None:
    """Which those are, is shown in test_storage.py."""
    ok, detail, remedy = finding(url(tmp_path / "none" / "a.db"))
    assert not ok
    assert "there is no folder" in detail
    assert "WRONGTURN_DATABASE" in remedy
    assert not (tmp_path / "none").exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everything")
def test_a_database_without_rights(tmp_path: Path) -> None:
    file = tmp_path / "a.db"
    file.touch(0o400)
    assert not finding(url(file))[0]


COMPILING = """
import os, pathlib, socket, sys
kernels = pathlib.Path(os.environ["NUMBA_CACHE_DIR"], "kernels")
if not kernels.exists():
    compiler = b"c" * 400 * 2**20
    kernels.touch()
connection = socket.socket(fileno=int(sys.argv[1]))
connection.sendall(bytes([0x91, 0]))  # msgpack of [OK]
connection.recv(1)
"""
"""In a simulator's place: the first to run has a compiler in memory, as numba's stays."""


@pytest.mark.parametrize("free", [2**34, 300 * 2**20])
def test_a_simulators_memory_is_told_without_the_compilers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free: int
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("WRONGTURN_SIMULATORS", "1")
    monkeypatch.setenv("WRONGTURN_SUBMISSIONS", "0")
    command = (sys.executable, "-c", COMPILING)
    monkeypatch.setitem(LocalStarter.__init__.__kwdefaults__, "command", command)  # type: ignore[arg-type]
    monkeypatch.setattr(check, "_COMPILED_S", 0.0)
    monkeypatch.setattr(check.Machine, "available_memory", lambda _: free)
    for _ in range(2):
        _name, ok, detail, _remedy = next(one for one in cli.checks() if one[0] == "simulators")
        assert ok
        (mib,) = re.findall(r"has (\d+) MiB", detail)
        assert int(mib) < 400
    monkeypatch.setenv("WRONGTURN_SUBMISSIONS", "1")
    _name, ok, detail, _remedy = next(one for one in cli.checks() if one[0] == "simulators")
    assert "4 sandboxes of submissions, about 1024 MiB" in detail
    assert ok == (free > 2**30)


def test_a_port_without_the_right_to_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(socket.socket, "bind", refuse)
    with pytest.raises(AddressError, match="--port 80: only root may listen on it; name a port above 1023"):
        bind("127.0.0.1", 80)
    with pytest.raises(AddressError, match="--port 8000: Permission denied"):
        bind("127.0.0.1", 8000)


@pytest.mark.parametrize(("limit", "simulators", "kept"), [(1024, 16, 128), (100, 16, 50), (1 << 20, 16, 128)])
def test_how_many_are_not_for_connections(limit: int, simulators: int, kept: int) -> None:
    assert server.for_connections(limit, simulators) == limit - kept


def test_too_few_are_told_at_the_start() -> None:
    with structlog.testing.capture_logs() as said:
        server.warn_if_few(1 << 20, 16, 4096)
        assert not said
        server.warn_if_few(1024, 16, 4096)
    assert said[0]["connections"] == 896
    assert "to 4224, or set WRONGTURN_MAX_CONNECTIONS to 896" in said[0]["remedy"]


def test_the_key_of_certificates_is_checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def found() -> tuple[str, bool, str, str]:
        return next(one for one in cli.checks() if one[0] == "signing key")

    assert found()[1:3] == (True, "in the database, so backups keep it")
    file = tmp_path / "signing_key"
    file.write_text("ab" * 32)
    file.chmod(0o600)
    monkeypatch.setenv("WRONGTURN_SIGNING_KEY_FILE", str(file))
    assert found()[1:3] == (True, f"in {file}; backups do not hold it")
    file.write_text("z" * 64)
    _, ok, detail, remedy = found()
    assert not ok
    assert "openssl rand -hex 32" in detail
    assert "docs/certificates.md" in remedy
