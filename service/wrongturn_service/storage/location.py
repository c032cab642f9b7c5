"""The database's URL, and the folder and lock of an SQLite file."""

import contextlib
import errno
import fcntl
import os
import struct
from pathlib import Path
from typing import Final

from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError

from wrongturn_service.errors import StartupError

NAMED_BY = "--database or WRONGTURN_DATABASE"
OTHERWISE = "use that one (other commands take its URL by --url or WRONGTURN_URL), stop it,"
"""Remedies if another service uses the database."""
OWNER_ALONE = 0o600
"""Mode of the database file, which holds hashes of tokens."""
_LOCKED_BYTE: Final = 1 << 62


def parse(url: str) -> URL:
    """Parse a URL and fill in the driver of SQLite or PostgreSQL.

    Raises StartupError if the URL is malformed, or names SQLite in memory.
    """
    try:
        parsed = make_url(url)
    except ArgumentError as error:
        raise StartupError(
            f"{url!r} is not a database URL; give one such as sqlite+aiosqlite:////path/wrongturn.db by {NAMED_BY}"
        ) from error
    if parsed.drivername == "sqlite":
        parsed = parsed.set(drivername="sqlite+aiosqlite")
    if parsed.drivername in {"postgresql", "postgres"}:
        parsed = parsed.set(drivername="postgresql+asyncpg")
    if parsed.get_backend_name() == "sqlite" and parsed.database in {None, "", ":memory:"}:
        raise StartupError(f"the database has to be a file, so that nothing recorded is lost; name one by {NAMED_BY}")
    return parsed


def file_of(url: URL) -> Path | None:
    """Return the file of an SQLite database, without symbolic links; None for other databases."""
    return Path(url.database or "").resolve() if url.get_backend_name() == "sqlite" else None


def ensure_folder(file: Path, home: Path | None) -> None:
    """Check that the file's folder exists. Only ``home`` is created; any other missing folder may be a typing error.

    Raises StartupError if the folder is missing or cannot be created.
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
    """Create the file if it is missing, readable by its owner only. SQLite gives its other files the same mode.

    Raises StartupError if the file cannot be created, or is gone while its write-ahead log is there.
    """
    log = file.with_name(f"{file.name}-wal")
    try:
        if log.exists() and not (file.exists() and file.stat().st_size):
            # SQLite would delete the log, under the service that still writes into it.
            raise StartupError(
                f"the database file {file} was deleted or moved, but its write-ahead log {log} is there: a service "
                "still uses them, or was killed; stop it and put the file back, or move the log to where the file is; "
                f"or name another by {NAMED_BY}"
            )
        with contextlib.suppress(FileExistsError):
            os.close(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, OWNER_ALONE))
    except OSError as error:
        raise unwritable(file, error) from error


def lock(file: Path) -> int:
    """Lock the database for this process and return the descriptor that holds the lock until it is closed.

    The lock is on the file itself, so it holds under each of the file's names, whatever is deleted beside it. Close the
    descriptor after the last connection: closing any descriptor of a file drops SQLite's own locks on it. Raises
    StartupError if another service has the lock, or the file cannot be written.
    """
    handle = _open(file)
    try:
        if not _locked(handle, file):
            raise StartupError(
                f"the database file {file} is in use by another Wrongturn service; {OTHERWISE} "
                f"or name another file by {NAMED_BY}"
            )
        if not os.path.samestat(os.fstat(handle), file.stat()):
            raise StartupError(f"the database file {file} was replaced at this moment; start again")
    except BaseException:
        os.close(handle)
        raise
    return handle


def in_use(file: Path) -> bool:
    """Return whether a service uses the file. Raises StartupError if it cannot be written."""
    if not file.exists():
        return False
    handle = _open(file)
    try:
        return not _locked(handle, file)
    finally:
        os.close(handle)


def unwritable(file: Path, error: OSError) -> StartupError:
    """Return the error for a file that the operating system refuses to write."""
    return StartupError(
        f"the database file {file} cannot be written: {error.strerror or error}; name another by {NAMED_BY}"
    )


def _open(file: Path) -> int:
    try:
        return os.open(file, os.O_RDWR | os.O_CLOEXEC)
    except OSError as error:
        raise unwritable(file, error) from error


def _locked(handle: int, file: Path) -> bool:
    """Lock one byte far behind those that SQLite locks. Return False if another process has done so."""
    wanted = struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_SET, _LOCKED_BYTE, 1, 0)
    try:
        fcntl.fcntl(handle, fcntl.F_OFD_SETLK, wanted)
    except OSError as error:
        if error.errno in {errno.EAGAIN, errno.EACCES}:
            return False
        raise unwritable(file, error) from error
    return True
