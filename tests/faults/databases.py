"""The two databases: where they are, how the server among them is killed and started again, what is in them."""

import asyncio
import contextlib
import os
import signal
import sqlite3
import subprocess
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import asyncpg
import psutil
from processes import children
from sqlalchemy.engine import make_url


class Store(ABC):
    """A database and who keeps it."""

    name: str
    url: str

    @abstractmethod
    def rows(self, query: str) -> list[dict[str, Any]]:
        """What a query gives, asked without the service."""

    @abstractmethod
    def written(self) -> int:
        """A number that changes when something is written."""

    def await_write(self) -> None:
        """Until something is written; where nothing is, for a while only."""
        before, deadline = self.written(), time.monotonic() + 2.0
        while self.written() == before and time.monotonic() < deadline:
            time.sleep(0.001)

    def driven(self) -> set[str]:
        """Evaluations with an open episode; none where nobody answers."""
        try:
            found = self.rows("SELECT evaluation_id FROM episodes WHERE state = 'open'")
        except (OSError, sqlite3.Error, asyncpg.PostgresError):
            return set()
        return {row["evaluation_id"] for row in found}

    def kill(self, _pick: float) -> bool:
        """Kill a process of the server; False where there was none."""
        return False


class File(Store):
    """SQLite's."""

    name = "SQLite"

    def __init__(self, folder: Path) -> None:
        self._file = folder / "wrongturn.db"
        self.url = f"sqlite+aiosqlite:///{self._file}"

    def rows(self, query: str) -> list[dict[str, Any]]:
        with contextlib.closing(sqlite3.connect(self._file)) as connection:
            connection.row_factory = sqlite3.Row
            return [dict(row) for row in connection.execute(query)]

    def written(self) -> int:
        return _changed([self._file.with_name(self._file.name + "-wal")])


class Server(Store):
    """A PostgreSQL server of one's own, by the wheel of the tests."""

    name = "PostgreSQL"

    def __init__(self, server: Any) -> None:
        self._server = server
        self.url = make_url(server.get_uri()).set(drivername="postgresql+asyncpg").render_as_string(hide_password=False)

    def rows(self, query: str) -> list[dict[str, Any]]:
        async def ask() -> list[dict[str, Any]]:
            connection = await asyncpg.connect(self._server.get_uri())
            try:
                return [dict(row) for row in await connection.fetch(query)]
            finally:
                await connection.close()

        return asyncio.run(ask())

    def written(self) -> int:
        return _changed((self._server.pgdata / "pg_wal").glob("0*"))

    def kill(self, pick: float) -> bool:
        """The postmaster one time in two, else one of its processes, whereupon it recovers by itself."""
        pid = self._server.get_pid()
        if pid is None or not psutil.pid_exists(pid):
            return False
        parts = children(pid)
        if pick >= 0.5 and parts:
            with contextlib.suppress(ProcessLookupError):
                os.kill(parts[int((pick - 0.5) * 2 * len(parts))], signal.SIGKILL)
                return True
            return False
        orphans = [psutil.Process(part) for part in parts if psutil.pid_exists(part)]
        os.kill(pid, signal.SIGKILL)
        psutil.wait_procs([*orphans, psutil.Process(pid)] if psutil.pid_exists(pid) else orphans, timeout=10)
        self._start_again()
        return True

    def _start_again(self) -> None:
        deadline = time.monotonic() + 60
        while True:
            try:
                # It finds the old one's file, sees that nobody is there any more, and starts another.
                self._server.ensure_postgres_running()
            except (subprocess.SubprocessError, AssertionError, OSError, psutil.Error):
                assert time.monotonic() < deadline, "PostgreSQL does not start again"
                time.sleep(0.2)
            else:
                return


def _changed(files: Iterable[Path]) -> int:
    """When the files were changed last, nanoseconds; 0 where there is none."""
    with contextlib.suppress(FileNotFoundError):
        return max((file.stat().st_mtime_ns for file in files), default=0)
    return 0
