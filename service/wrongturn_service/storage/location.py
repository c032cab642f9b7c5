"""Where the database lies: its URL, and an SQLite file's folder and lock."""

import contextlib
import fcntl
import os
from pathlib import Path

from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError

from wrongturn_service.errors import StartupError

NAMED_BY = "--database or WRONGTURN_DATABASE"
OTHERWISE = "use that one (other commands take its URL by --url or WRONGTURN_URL), stop it,"
"""What can be done about a service that has the database, beside naming another one."""
OWNER_ALONE = 0o600
"""The mode of what holds the database: hashes of tokens and sealed tokens are in it."""


class DatabaseUrlError(StartupError):
    """The URL is no database's that could be used anywhere: a mistake in what was asked for."""


def parse(url: str) -> URL:
    """The URL's parts, the driver of SQLite or PostgreSQL filled in.

    Raises:
        DatabaseUrlError: it is none, or keeps SQLite in memory.
    """
    try:
        parsed = make_url(url)
    except ArgumentError as error:
        raise DatabaseUrlError(
            f"the database URL {url!r} is none; give one such as sqlite+aiosqlite:////path/wrongturn.db by {NAMED_BY}",
        ) from error
    if parsed.drivername == "sqlite":
        parsed = parsed.set(drivername="sqlite+aiosqlite")
    if parsed.drivername in {"postgresql", "postgres"}:
        parsed = parsed.set(drivername="postgresql+asyncpg")
    if parsed.get_backend_name() == "sqlite" and parsed.database in {None, "", ":memory:"}:
        raise DatabaseUrlError(
            f"the database has to be a file, so that nothing recorded is lost; name one by {NAMED_BY}",
        )
    return parsed


def file_of(url: URL) -> Path | None:
    """An SQLite database's file; None for a database of another kind."""
    return Path(url.database or "").absolute() if url.get_backend_name() == "sqlite" else None


def ensure_folder(file: Path, home: Path | None) -> None:
    """See that the file's folder is there. Only the home is made: any other may be a slip of the pen.

    Raises:
        StartupError: it is not, or cannot be made.
    """
    folder = file.parent
    try:
        if folder == home:
            folder.mkdir(parents=True, exist_ok=True)
        there = folder.is_dir()
    except OSError as error:
        raise unwritable(file, error) from error
    if not there:
        raise StartupError(f"there is no folder {folder} for the database file; make it, or name another by {NAMED_BY}")


def ensure_file(file: Path) -> None:
    """Make the file where it is not there, for its owner alone; SQLite gives what it keeps beside it the same mode.

    Raises:
        StartupError: it cannot be made.
    """
    try:
        with contextlib.suppress(FileExistsError):
            os.close(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, OWNER_ALONE))
    except OSError as error:
        raise unwritable(file, error) from error


def lock(file: Path) -> int:
    """Lock the file for this process; gives the handle that holds the lock until it is closed.

    Raises:
        StartupError: another service has it, or the lock cannot be written.
    """
    try:
        handle = os.open(_lock_of(file), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, OWNER_ALONE)
    except OSError as error:
        raise unwritable(file, error) from error
    if not _locked(handle):
        raise StartupError(
            f"the database file {file} is in use by another Wrongturn service; {OTHERWISE} "
            f"or name another file by {NAMED_BY}",
        )
    return handle


def in_use(file: Path) -> bool:
    """Whether a service has the file. Leaves nothing behind.

    Raises:
        StartupError: its lock cannot be written.
    """
    try:
        handle = os.open(_lock_of(file), os.O_RDWR | os.O_CLOEXEC)
    except FileNotFoundError:
        return False
    except OSError as error:
        raise unwritable(file, error) from error
    if not _locked(handle):
        return True
    os.close(handle)
    return False


def unwritable(file: Path, error: OSError) -> StartupError:
    """What is told where the operating system refuses."""
    return StartupError(
        f"the database file {file} cannot be written: {error.strerror or error}; name another by {NAMED_BY}",
    )


def _lock_of(file: Path) -> Path:
    # A file beside the database: SQLite's own locks on it would be lost when any handle of it is closed.
    return file.with_name(file.name + ".lock")


def _locked(handle: int) -> bool:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        return False
    return True
