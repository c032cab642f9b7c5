"""Backup and restore of the database. A backup is consistent and can be made while the service runs.

SQLite uses its online backup, whose file is a database itself. PostgreSQL uses ``pg_dump`` in its custom format.
"""

import contextlib
import os
import shutil
import sqlite3
import subprocess
from pathlib import Path

from sqlalchemy.engine import URL

from wrongturn_service.errors import StartupError
from wrongturn_service.storage import location
from wrongturn_service.storage.check import examine


def back_up(url: str, file: Path) -> None:
    """Write a backup, completely or not at all. A service may run meanwhile.

    Raises StartupError if the database or the file cannot be used.
    """
    parsed = location.parse(url)
    if file.exists():
        raise StartupError(f"{file} already exists; name another file")
    if not file.parent.is_dir():
        raise StartupError(f"there is no folder {file.parent}; make it, or name another file")
    part = file.with_name(file.name + ".part")
    try:
        _make(part)
        source = location.file_of(parsed)
        if source is not None:
            _copy(source, part)
        else:
            _run_program(parsed, "pg_dump", "--format=custom", f"--file={part}")
        with part.open("rb") as written:
            os.fsync(written.fileno())
        part.replace(file)
    except OSError as error:
        raise StartupError(f"the backup {file} cannot be written: {error.strerror or error}; name another") from error
    finally:
        part.unlink(missing_ok=True)


def check_file(file: Path) -> None:
    """Raise StartupError if there is no such file."""
    if not file.is_file():
        raise StartupError(f"there is no backup {file}; name one that 'wrongturn backup' made")


def restore(url: str, file: Path, home: Path) -> None:
    """Replace the database by a backup.

    Only the ``home`` may be created. Raises StartupError if a service uses the database, or the backup or the database
    cannot be used.
    """
    parsed = location.parse(url)
    check_file(file)
    target = location.file_of(parsed)
    if target is None:
        if "is in use" in examine(url, home):
            raise StartupError("a service uses the database; stop it first")
        options = ("--clean", "--if-exists", "--no-owner", "--single-transaction", "--exit-on-error")
        _run_program(parsed, "pg_restore", *options, str(file), database_option=True)
        return
    location.ensure_folder(target, home)
    # A service makes the file before it locks it.
    lock = location.lock(target) if target.exists() else None
    try:
        part = target.with_name(target.name + ".part")
        try:
            _make(part, target.stat().st_mode & 0o777 if target.exists() else location.OWNER_ALONE)
            _copy(file, part)
            with part.open("rb") as written:
                os.fsync(written.fileno())
            # The old file's log must not be applied to the new file.
            for tail in ("-wal", "-shm"):
                target.with_name(target.name + tail).unlink(missing_ok=True)
            part.replace(target)
        except OSError as error:
            raise location.unwritable(target, error) from error
        finally:
            part.unlink(missing_ok=True)
    finally:
        if lock is not None:
            os.close(lock)


def _make(part: Path, mode: int = location.OWNER_ALONE) -> None:
    """Create an empty file with this mode, or empty the one that an earlier attempt left."""
    handle = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, location.OWNER_ALONE)
    try:
        os.fchmod(handle, mode)
    finally:
        os.close(handle)


def _copy(source: Path, target: Path) -> None:
    """Copy a database by SQLite's online backup and check the copy."""
    try:
        with (
            contextlib.closing(sqlite3.connect(f"{source.absolute().as_uri()}?mode=ro", uri=True)) as old,
            contextlib.closing(sqlite3.connect(target)) as new,
        ):
            if not old.execute("SELECT name FROM sqlite_master WHERE name = 'alembic_version'").fetchall():
                raise StartupError(f"{source} is not a Wrongturn database; name another")
            old.backup(new)
            # One file, without a log beside it.
            new.execute("PRAGMA journal_mode = DELETE")
            found = new.execute("PRAGMA integrity_check").fetchone()[0]
    except sqlite3.Error as error:
        raise StartupError(f"{source} cannot be copied: {error}; name another file") from error
    if found != "ok":
        raise StartupError(f"{source} is damaged: {found}; name another file")


def _run_program(url: URL, name: str, *arguments: str, database_option: bool = False) -> None:
    program = shutil.which(name)
    plain = URL.create(
        "postgresql", username=url.username, host=url.host, port=url.port, database=url.database, query=url.query
    )
    shown = plain.render_as_string()
    command = [*arguments, f"--dbname={shown}"] if database_option else [*arguments, shown]
    if program is None:
        raise StartupError(
            f"{name} is missing; install PostgreSQL's client programs, or run this where they are: "
            f"{' '.join([name, *command])}"
        )
    # Everybody on the machine can read a program's arguments, so the password is not among them.
    environment = {**os.environ, **({} if url.password is None else {"PGPASSWORD": str(url.password)})}
    done = subprocess.run(  # noqa: S603 - PostgreSQL's own program
        [program, *command], env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise StartupError(f"{name} failed: {done.stderr.strip() or f'status {done.returncode}'}")
