"""The database: one service each, migrated at the start, every commit on disk before anybody learns of it."""

import asyncio
import contextlib
import os
import sqlite3
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any, Self

from alembic import command
from alembic.config import Config
from alembic.util import CommandError
from sqlalchemy import Connection, event, inspect, text
from sqlalchemy.engine import URL
from sqlalchemy.exc import NoSuchModuleError, SQLAlchemyError
from sqlalchemy.ext.asyncio import AsyncEngine, AsyncSession, create_async_engine

from wrongturn_service.errors import StartupError
from wrongturn_service.storage import location, postgres
from wrongturn_service.storage.condition import Condition, FailureKind, StorageError
from wrongturn_service.storage.models import Base, ProbeRow
from wrongturn_service.telemetry import Telemetry

_READ = "wrongturn_read"
_BUSY_MS = 30_000
_PROBE_BYTES = 256 * 1024
"""Size of the write that shows whether the database works again: as much as the end of a long episode."""
_PROBE_EVERY_S = 2.0


class DatabaseGoneError(StorageError):
    """The database file was deleted, moved or replaced, so writes would be lost."""

    kind = FailureKind.GONE


class Database:
    """An engine and its lock. Create it with :meth:`open`."""

    def __init__(
        self,
        engine: AsyncEngine,
        resources: contextlib.AsyncExitStack,
        ownership: postgres.Ownership | None,
        file: Path | None,
        telemetry: Telemetry | None,
    ) -> None:
        self.condition = (
            Condition() if telemetry is None else Condition(lambda kind: telemetry.storage_errors.labels(kind).inc())
        )
        self._telemetry = telemetry
        self._probing: asyncio.Task[None] | None = None
        self._writing = engine
        self._resources = resources
        self._file = file
        self._identity = None if file is None else _identity(file)
        options: dict[str, Any] = {_READ: True}
        if ownership is not None:
            options |= {"isolation_level": "REPEATABLE READ", "postgresql_readonly": True}
        self._reading = engine.execution_options(**options)
        self._ownership = ownership
        # One writer at a time. SQLite allows no more, and waiting here costs less than its polling. PostgreSQL would,
        # but its transactions could then make each other fail; a service writes little, in milliseconds each.
        self._writer = asyncio.Lock()

    @classmethod
    async def open(cls, url: str, *, home: Path | None = None, telemetry: Telemetry | None = None) -> Self:
        """Connect, lock the file or the server's database, and migrate the tables.

        A missing folder of the file is made only if it is the ``home``. Raises StartupError if the URL is wrong, its
        folder is missing, the file cannot be written, the server does not answer, another service uses the database, or
        a newer version made it.
        """
        parsed = location.parse(url)
        file = location.file_of(parsed)
        ownership = None
        async with contextlib.AsyncExitStack() as stack:
            if file is not None:
                location.ensure_folder(file, home)
                location.ensure_file(file)
                stack.callback(os.close, location.lock(file))
            with startup_errors(parsed.render_as_string(hide_password=True)), postgres.one_error():
                if file is not None:
                    _probe(parsed)
                engine = _engine(parsed)
                if parsed.get_backend_name() == "postgresql":
                    ownership = postgres.Ownership(parsed)
                    stack.push_async_callback(ownership.close)
                    await ownership.take()
                stack.push_async_callback(engine.dispose)
                async with engine.begin() as connection:
                    await connection.run_sync(_migrate)
                    if ownership is not None:
                        await ownership.sign(connection)
                        await postgres.warn_of_unsafe_settings(connection)
            return cls(engine, stack.pop_all(), ownership, file, telemetry)

    def check(self) -> None:
        """Check without a query that the database is there and ours. Raises DatabaseGoneError, DatabaseTakenError."""
        if self._file is not None and _identity(self._file) != self._identity:
            raise DatabaseGoneError(f"{self._file} was deleted, moved or replaced; put it back or restart the service")
        if self._ownership is not None:
            self._ownership.check_known()

    @contextlib.asynccontextmanager
    async def read(self) -> AsyncIterator[AsyncSession]:
        """Open a read-only session on one snapshot."""
        with self._observed("read"), postgres.one_error():
            async with AsyncSession(self._reading, expire_on_commit=False) as session:
                yield session

    @contextlib.asynccontextmanager
    async def write(self) -> AsyncIterator[AsyncSession]:
        """Open a session. Its changes are on disk when the block ends, or undone if it raises."""
        async with self._writer:
            with self._observed("write"), postgres.one_error():
                self.check()
                self.condition.writing_since = time.monotonic()
                async with AsyncSession(self._writing, expire_on_commit=False) as session, session.begin():
                    if self._ownership is not None:
                        await self._ownership.check(session)
                    yield session
            self.condition.wrote()

    @contextlib.contextmanager
    def _observed(self, operation: str) -> Iterator[None]:
        """Note what becomes of a transaction. After a failure, small writes find out when the database works again."""
        began = time.perf_counter()
        try:
            yield
        except SQLAlchemyError as error:
            self.condition.failed(error)
            if self.condition.failing and (self._probing is None or self._probing.done()):
                self._probing = asyncio.create_task(self._probe())
            raise
        finally:
            if operation == "write":
                self.condition.writing_since = None
            if self._telemetry is not None:
                self._telemetry.database.labels(operation).observe(time.perf_counter() - began)

    async def _probe(self) -> None:
        while self.condition.failing:
            await asyncio.sleep(_PROBE_EVERY_S)
            with contextlib.suppress(SQLAlchemyError):
                async with self.write() as session:
                    await session.merge(ProbeRow(id=1, data=os.urandom(_PROBE_BYTES)))

    async def close(self) -> None:
        """Close the connections and release the lock."""
        if self._probing is not None:
            self._probing.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._probing
        await self._resources.aclose()


def _identity(file: Path) -> tuple[int, int] | None:
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


@contextlib.contextmanager
def startup_errors(shown: str) -> Iterator[None]:
    """Turn errors of opening a database, as it is shown, into StartupErrors with a remedy."""
    try:
        yield
    except CommandError as error:
        raise StartupError(
            f"the database {shown} was made by another version of Wrongturn ({error}); "
            f"use that version, or name another database by {location.NAMED_BY}"
        ) from error
    except (SQLAlchemyError, sqlite3.Error, OSError, ModuleNotFoundError) as error:
        reason = str(getattr(error, "orig", None) or error).splitlines()[0]
        raise StartupError(
            f"the database {shown} cannot be used: {reason}; name another by {location.NAMED_BY}"
        ) from error


def _probe(url: URL) -> None:
    """Raise sqlite3's error if the file cannot be opened.

    The asynchronous driver must not find out itself: its thread would keep the process alive.
    """
    with contextlib.closing(sqlite3.connect(url.database or "")) as connection:
        connection.execute("PRAGMA schema_version")


def _engine(url: URL) -> AsyncEngine:
    try:
        engine = create_async_engine(
            url,
            # Replaces a connection that the server has closed.
            pool_pre_ping=url.get_backend_name() == "postgresql",
            connect_args=postgres.connect_args(url),
        )
    except NoSuchModuleError as error:
        raise StartupError(
            f"no driver for the database {url.drivername!r}; use sqlite+aiosqlite or postgresql+asyncpg"
        ) from error
    if url.get_backend_name() == "sqlite":
        event.listen(engine.sync_engine, "connect", _set_up_sqlite)
        event.listen(engine.sync_engine, "begin", _begin_sqlite)
    return engine


def _set_up_sqlite(connection: Any, _record: object) -> None:
    # Python's driver would begin transactions too late; _begin_sqlite does it.
    connection.isolation_level = None
    cursor = connection.cursor()
    cursor.execute(f"PRAGMA busy_timeout = {_BUSY_MS}")
    cursor.execute("PRAGMA journal_mode = WAL")
    cursor.execute("PRAGMA synchronous = FULL")
    cursor.execute("PRAGMA foreign_keys = ON")
    cursor.close()


def _begin_sqlite(connection: Connection) -> None:
    # A writer locks at once. A reader that becomes a writer fails if somebody wrote in between.
    reads = connection.get_execution_options().get(_READ)
    connection.exec_driver_sql("BEGIN" if reads else "BEGIN IMMEDIATE")


def migrations() -> Config:
    """Return Alembic's configuration for the scripts beside this file."""
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).with_name("migrations")).replace("%", "%%"))
    return config


def _migrate(connection: Connection) -> None:
    config = migrations()
    config.attributes["connection"] = connection
    if not inspect(connection).has_table("alembic_version"):
        Base.metadata.create_all(connection)
        command.stamp(config, "head")
        return
    # Alembic would read all its scripts, in 0.1 s, to find that there is nothing to do.
    scripts = Path(__file__).parent.glob("migrations/versions/[0-9]*.py")
    newest = max(script.name.partition("_")[0] for script in scripts)
    if connection.scalar(text("SELECT version_num FROM alembic_version")) != newest:
        command.upgrade(config, "head")
