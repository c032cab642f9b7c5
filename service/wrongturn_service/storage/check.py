"""Checks whether a service could use the database, without changing it."""

import asyncio
import contextlib
import os
import sqlite3
import tempfile
from pathlib import Path

from alembic.script import ScriptDirectory
from sqlalchemy import inspect, text
from sqlalchemy.engine import URL
from sqlalchemy.ext.asyncio import create_async_engine

from wrongturn_service.storage import location, postgres
from wrongturn_service.storage.database import migrations, startup_errors


def examine(url: str, home: Path) -> str:
    """Return a sentence about a database that a service can use.

    Only the ``home`` may be created. Raises StartupError if a service could not use the database. The message says why.
    """
    parsed = location.parse(url)
    shown = parsed.render_as_string(hide_password=True)
    file = location.file_of(parsed)
    if file is not None:
        return _examine_file(file, home)
    with startup_errors(shown):
        versions, free = asyncio.run(_ask(parsed))
        _check_known(versions)
    return f"{shown} can be used" if free else f"{shown} is in use by a running service"


def _examine_file(file: Path, home: Path) -> str:
    location.ensure_folder(file, home)
    if location.in_use(file):
        return f"{file} is in use by a running service"
    try:
        # SQLite and the lock need to create files beside the database.
        with tempfile.TemporaryFile(dir=file.parent):
            pass
        if not file.exists():
            return f"{file} can be created"
        os.close(os.open(file, os.O_RDWR | os.O_CLOEXEC))
    except OSError as error:
        raise location.unwritable(file, error) from error
    with (
        startup_errors(str(file)),
        contextlib.closing(sqlite3.connect(f"{file.as_uri()}?mode=rw", uri=True)) as connection,
    ):
        tables = connection.execute("SELECT name FROM sqlite_master WHERE name = 'alembic_version'").fetchall()
        versions = connection.execute("SELECT version_num FROM alembic_version").fetchall() if tables else []
        _check_known([version for (version,) in versions])
    return f"{file} can be used"


def _check_known(versions: list[str]) -> None:
    """Raise Alembic's CommandError if a later version made the tables."""
    known = ScriptDirectory.from_config(migrations())
    for version in versions:
        known.get_revision(version)


async def _ask(url: URL) -> tuple[list[str], bool]:
    """Return the versions of the tables, and whether the database is free."""
    engine = create_async_engine(url, connect_args=postgres.connect_args(url))
    try:
        with postgres.one_error():
            async with engine.connect() as connection:
                there = await connection.run_sync(lambda now: inspect(now).has_table("alembic_version"))
                asked = "SELECT version_num FROM alembic_version"
                versions = list(await connection.scalars(text(asked))) if there else []
                # This lock ends with the transaction.
                free = await connection.scalar(text("SELECT pg_try_advisory_xact_lock(:key)"), {"key": postgres.LOCK})
        return versions, bool(free)
    finally:
        await engine.dispose()
