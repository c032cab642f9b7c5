"""What PostgreSQL needs beside SQLAlchemy: durable commits, one service per database, and one kind of error."""

import asyncio
import contextlib
import time
from collections.abc import Iterator
from typing import Any, Final

import asyncpg
import structlog
from sqlalchemy import text
from sqlalchemy.engine import URL
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine, AsyncSession, create_async_engine
from sqlalchemy.pool import NullPool

from wrongturn_service.errors import StartupError
from wrongturn_service.storage import location
from wrongturn_service.storage.condition import FailureKind, StorageError, kind_of_state
from wrongturn_service.tokens import new_id

LOCK: Final = 0x77726F6E67
"""Number of the advisory lock. Each database of a server has its own."""
PATIENCE_S: Final = 5.0
"""Seconds to wait for the lock: the server notices a little late that a service has ended."""
_CONNECT_S = 10
_COMMAND_S = 60
_AGAIN_S = 0.2


class DatabaseUnreachableError(StorageError):
    """The server does not answer. Try again."""

    kind = FailureKind.UNREACHABLE


class DatabaseTakenError(StorageError):
    """Another service has taken the database, so this one must not write any more."""

    kind = FailureKind.TAKEN


def connect_args(url: URL) -> dict[str, Any]:
    """Return the driver's arguments for PostgreSQL, none for other databases."""
    if url.get_backend_name() != "postgresql":
        return {}
    settings = {
        "application_name": "wrongturn",
        # A commit returns once it is on disk, whatever the server's configuration says.
        "synchronous_commit": "on",
        # A machine that has vanished must not hold the lock for hours.
        "tcp_keepalives_idle": "10",
        "tcp_keepalives_interval": "5",
        "tcp_keepalives_count": "3",
    }
    return {"timeout": _CONNECT_S, "command_timeout": _COMMAND_S, "server_settings": settings}


@contextlib.contextmanager
def one_error() -> Iterator[None]:
    """Turn errors of the driver that SQLAlchemy does not wrap into DatabaseUnreachableError."""
    try:
        yield
    except (OSError, asyncpg.PostgresError, asyncpg.InterfaceError) as error:
        reason = str(error) or type(error).__name__
        unreachable = DatabaseUnreachableError(f"the database does not answer: {reason}")
        unreachable.kind = kind_of_state(getattr(error, "sqlstate", None)) or unreachable.kind
        raise unreachable from error


class Ownership:
    """One service's ownership of one database.

    An advisory lock on a connection of its own refuses a second service at its start. If that connection breaks,
    another service may take the lock; so a row names the owner, and every write checks it.
    """

    def __init__(self, url: URL) -> None:
        self._engine: AsyncEngine = create_async_engine(
            url, poolclass=NullPool, isolation_level="AUTOCOMMIT", connect_args=connect_args(url)
        )
        self._shown = url.render_as_string(hide_password=True)
        self._me = new_id("sv")
        self._connection: AsyncConnection | None = None
        self._taken = False

    async def take(self, patience_s: float = PATIENCE_S) -> None:
        """Lock the database.

        Raises:
            StartupError: Another service has it.
            SQLAlchemyError: The server does not answer.
        """
        deadline = time.monotonic() + patience_s
        while not await self._lock():
            if time.monotonic() >= deadline:
                raise StartupError(
                    f"the database {self._shown} is in use by another Wrongturn service; {location.OTHERWISE} "
                    f"or name another by {location.NAMED_BY}"
                )
            await asyncio.sleep(_AGAIN_S)

    async def sign(self, connection: AsyncConnection) -> None:
        """Write this service's name into the row of the owner. The tables must exist."""
        await connection.execute(
            text(
                "INSERT INTO ownership (id, holder, since) VALUES (1, :me, :now) "
                "ON CONFLICT (id) DO UPDATE SET holder = excluded.holder, since = excluded.since"
            ),
            {"me": self._me, "now": time.time()},
        )

    async def check(self, session: AsyncSession) -> None:
        """Check that this service owns the database, and keep it so until the transaction ends.

        Raises:
            DatabaseTakenError: Another service owns it.
            DatabaseUnreachableError: The lock is not free yet, though no other service owns the database.
        """
        self.check_known()
        locked = not await self._lost() or await self._lock()
        # A service that takes over waits for this row, and so for this transaction.
        mine = text("SELECT 1 FROM ownership WHERE id = 1 AND holder = :me FOR SHARE")
        if await session.scalar(mine, {"me": self._me}) is None:
            self._refuse()
        if not locked:
            # Where a network cuts connections, the server notices later than this service, and keeps the old one's lock
            # until then.
            raise DatabaseUnreachableError("the database's lock is not free yet; try again")

    def check_known(self) -> None:
        """Raise DatabaseTakenError if a write found another owner."""
        if self._taken:
            self._refuse()

    async def close(self) -> None:
        """Release the database."""
        connection, self._connection = self._connection, None
        if connection is not None:
            with contextlib.suppress(OSError, SQLAlchemyError, asyncpg.PostgresError, asyncpg.InterfaceError):
                await connection.close()
        await self._engine.dispose()

    def _refuse(self) -> None:
        if not self._taken:
            structlog.get_logger("storage").error("database taken by another service", database=self._shown)
        self._taken = True
        raise DatabaseTakenError("another Wrongturn service has taken the database; stop this one")

    async def _lost(self) -> bool:
        """Return whether the lock's connection broke."""
        if self._connection is None or self._connection.closed:
            return True
        driver: Any = (await self._connection.get_raw_connection()).driver_connection
        return driver is None or bool(driver.is_closed())

    async def _lock(self) -> bool:
        if self._connection is not None:
            with contextlib.suppress(OSError, SQLAlchemyError, asyncpg.PostgresError, asyncpg.InterfaceError):
                await self._connection.invalidate()
                await self._connection.close()
            self._connection = None
        connection = await self._engine.connect()
        try:
            got = await connection.scalar(text("SELECT pg_try_advisory_lock(:key)"), {"key": LOCK})
        except BaseException:
            await connection.close()
            raise
        if not got:
            await connection.close()
            return False
        self._connection = connection
        return True


async def warn_of_unsafe_settings(connection: AsyncConnection) -> None:
    """Log a warning if the server's settings can lose a commit in a power failure."""
    for name in ("fsync", "full_page_writes"):
        if await connection.scalar(text(f"SELECT current_setting('{name}')")) != "on":
            structlog.get_logger("storage").warning("commits are not safe", setting=name, remedy=f"set {name} = on")
