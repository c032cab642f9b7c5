"""What PostgreSQL needs beside SQLAlchemy: durable commits, one service to a database, errors of its driver told."""

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
from wrongturn_service.tokens import new_id

LOCK: Final = 0x77726F6E67
"""The advisory lock's number, in every database of a server the same: such locks belong to one database each."""
PATIENCE_S: Final = 5.0
"""Seconds in which a service that has just ended must have let go: the server notices it a moment later."""
_CONNECT_S = 10
_COMMAND_S = 60
_AGAIN_S = 0.2


class DatabaseUnreachableError(SQLAlchemyError):
    """The server does not answer; what was asked can be asked again."""


class DatabaseTakenError(SQLAlchemyError):
    """Another service has had the database meanwhile: this one must not write to it again."""


def connect_args(url: URL) -> dict[str, Any]:
    """What the driver is told; empty for another database than PostgreSQL."""
    if url.get_backend_name() != "postgresql":
        return {}
    settings = {
        "application_name": "wrongturn",
        # Only a commit that is on the disk is told, whatever the server's own configuration is.
        "synchronous_commit": "on",
        # A machine that vanished must not hold the lock for hours.
        "tcp_keepalives_idle": "10",
        "tcp_keepalives_interval": "5",
        "tcp_keepalives_count": "3",
    }
    return {"timeout": _CONNECT_S, "command_timeout": _COMMAND_S, "server_settings": settings}


@contextlib.contextmanager
def told() -> Iterator[None]:
    """Make one error of what the driver raises where SQLAlchemy does not look.

    Raises:
        DatabaseUnreachableError: see there.
    """
    try:
        yield
    except (OSError, asyncpg.PostgresError, asyncpg.InterfaceError) as error:
        reason = str(error) or type(error).__name__
        raise DatabaseUnreachableError(f"the database does not answer: {reason}") from error


class Ownership:
    """One service's hold on one database.

    Two things make it safe. An advisory lock, held by a connection of its own, refuses a second service at its start.
    A row names the owner, and every transaction that writes looks at it: where the lock's connection broke and another
    service came in between, this one is refused from then on.
    """

    def __init__(self, url: URL) -> None:
        self._engine: AsyncEngine = create_async_engine(
            url,
            poolclass=NullPool,
            isolation_level="AUTOCOMMIT",
            connect_args=connect_args(url),
        )
        self._shown = url.render_as_string(hide_password=True)
        self._me = new_id("sv")
        self._connection: AsyncConnection | None = None
        self._taken = False

    async def take(self, patience_s: float = PATIENCE_S) -> None:
        """Lock the database.

        Raises:
            StartupError: another service has it.
            SQLAlchemyError: it does not answer.
        """
        deadline = time.monotonic() + patience_s
        while not await self._lock():
            if time.monotonic() >= deadline:
                raise StartupError(
                    f"the database {self._shown} is in use by another Wrongturn service; {location.OTHERWISE} "
                    f"or name another by {location.NAMED_BY}",
                )
            await asyncio.sleep(_AGAIN_S)

    async def sign(self, connection: AsyncConnection) -> None:
        """Put this service's name down as the owner's; the tables have to be there."""
        await connection.execute(
            text(
                "INSERT INTO ownership (id, holder, since) VALUES (1, :me, :now) "
                "ON CONFLICT (id) DO UPDATE SET holder = excluded.holder, since = excluded.since",
            ),
            {"me": self._me, "now": time.time()},
        )

    async def check(self, session: AsyncSession) -> None:
        """See that the database is still this service's, until the session's transaction ends.

        Raises:
            DatabaseTakenError: it is not.
        """
        if not self._taken and await self._lost() and not await self._lock():
            self._refuse()
        # A service that takes over has to wait for this row, and so for this transaction.
        mine = text("SELECT 1 FROM ownership WHERE id = 1 AND holder = :me FOR SHARE")
        if self._taken or await session.scalar(mine, {"me": self._me}) is None:
            self._refuse()

    def check_known(self) -> None:
        """Raise DatabaseTakenError where a write found it so."""
        if self._taken:
            self._refuse()

    async def close(self) -> None:
        """Let go of the database."""
        connection, self._connection = self._connection, None
        if connection is not None:
            with contextlib.suppress(OSError, SQLAlchemyError, asyncpg.PostgresError, asyncpg.InterfaceError):
                await connection.close()
        await self._engine.dispose()

    def _refuse(self) -> None:
        if not self._taken:
            structlog.get_logger("storage").error("database taken by another service", database=self._shown)
        self._taken = True
        raise DatabaseTakenError("another Wrongturn service has taken the database; this one has to be ended")

    async def _lost(self) -> bool:
        """Whether the lock's connection broke."""
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


async def warn_of_a_careless_server(connection: AsyncConnection) -> None:
    """Say so where the server's own settings let a commit be lost by a power failure."""
    for name in ("fsync", "full_page_writes"):
        if await connection.scalar(text(f"SELECT current_setting('{name}')")) != "on":
            structlog.get_logger("storage").warning("commits are not safe", setting=name, remedy=f"set {name} = on")
