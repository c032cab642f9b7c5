"""What is known of the database's condition: which failures there were, and whether it works now."""

import sqlite3
import time
from enum import StrEnum
from typing import Final, Protocol

import structlog
from sqlalchemy.exc import DBAPIError, IntegrityError, SQLAlchemyError


class FailureKind(StrEnum):
    """Why a transaction failed."""

    FULL = "full"
    IO = "io"
    READ_ONLY = "read-only"
    BUSY = "busy"
    DAMAGED = "damaged"
    GONE = "gone"
    TAKEN = "taken"
    UNREACHABLE = "unreachable"
    OTHER = "other"


SENTENCES: Final = {
    FailureKind.FULL: "its disk is full",
    FailureKind.IO: "its disk or file system fails",
    FailureKind.READ_ONLY: "it is read-only",
    FailureKind.BUSY: "another program has locked it",
    FailureKind.DAMAGED: "it is damaged",
    FailureKind.GONE: "its file was deleted, moved or replaced",
    FailureKind.TAKEN: "another service has taken it",
    FailureKind.UNREACHABLE: "its server does not answer",
}
"""What the service says in public. The log has the database's own words."""
STUCK_S: Final = 10.0
"""Seconds after which a write that goes on counts as a failure. It takes milliseconds otherwise."""
_BY_SQLITE_CODE: Final = {
    sqlite3.SQLITE_FULL: FailureKind.FULL,
    sqlite3.SQLITE_IOERR: FailureKind.IO,
    sqlite3.SQLITE_CANTOPEN: FailureKind.IO,
    sqlite3.SQLITE_READONLY: FailureKind.READ_ONLY,
    sqlite3.SQLITE_BUSY: FailureKind.BUSY,
    sqlite3.SQLITE_LOCKED: FailureKind.BUSY,
    sqlite3.SQLITE_CORRUPT: FailureKind.DAMAGED,
    sqlite3.SQLITE_NOTADB: FailureKind.DAMAGED,
}
_BY_SQLSTATE: Final = (
    ("53100", FailureKind.FULL),
    ("25006", FailureKind.READ_ONLY),
    ("57014", FailureKind.BUSY),
    ("55P03", FailureKind.BUSY),
    ("XX001", FailureKind.DAMAGED),
    ("XX002", FailureKind.DAMAGED),
    ("58", FailureKind.IO),
    ("53", FailureKind.UNREACHABLE),
    ("57", FailureKind.UNREACHABLE),
    ("08", FailureKind.UNREACHABLE),
)
"""PostgreSQL's codes, by their beginning. The first that fits counts."""


class StorageError(SQLAlchemyError):
    """Base of the storage's own errors."""

    kind: FailureKind


class Watcher(Protocol):
    """Is told of transactions."""

    def transacted(self, operation: str, seconds: float) -> None:
        """Note how long a ``read`` or ``write`` took."""

    def storage_failed(self, kind: str) -> None:
        """Count a failed transaction."""


class Condition:
    """Follows the transactions of a database."""

    def __init__(self, watcher: Watcher | None = None) -> None:
        self._watcher = watcher
        self._failure: FailureKind | None = None
        self._writing_since: float | None = None
        self._log = structlog.get_logger("storage")

    @property
    def trouble(self) -> str | None:
        """Why the database cannot be used now, as a sentence; None if nothing is known against it."""
        if self._failure is not None:
            return SENTENCES[self._failure]
        since = self._writing_since
        if since is not None and time.monotonic() - since >= STUCK_S:
            return f"a write has not ended within {STUCK_S:g} s"
        return None

    @property
    def failing(self) -> bool:
        """Whether a transaction failed, and no write has succeeded since."""
        return self._failure is not None

    def writing(self) -> None:
        """Note that a write begins."""
        self._writing_since = time.monotonic()

    def ended(self, operation: str, seconds: float) -> None:
        """Note that a transaction has ended, whatever came of it."""
        if operation == "write":
            self._writing_since = None
        if self._watcher is not None:
            self._watcher.transacted(operation, seconds)

    def wrote(self) -> None:
        """Note that a write is on disk."""
        if self._failure is not None:
            self._failure = None
            self._log.warning("the database works again")

    def failed(self, error: SQLAlchemyError) -> None:
        """Note that a transaction failed. One that was refused because of its data says nothing about the database."""
        kind = kind_of(error)
        if kind is None:
            return
        if self._watcher is not None:
            self._watcher.storage_failed(kind)
        # A damaged row is one row. What is not known may be the caller's fault.
        if kind is FailureKind.OTHER or (isinstance(error, StorageError) and kind is FailureKind.DAMAGED):
            return
        if kind is not self._failure:
            self._log.error("the database fails", kind=kind.value, reason=str(getattr(error, "orig", None) or error))
        self._failure = kind


def kind_of(error: SQLAlchemyError) -> FailureKind | None:
    """Return why a transaction failed; None if the database only refused its data."""
    if isinstance(error, StorageError):
        return error.kind
    if not isinstance(error, DBAPIError) or isinstance(error, IntegrityError):
        return None
    if isinstance(error.orig, sqlite3.Error):
        # An extended code has the primary one in its lowest byte.
        code = getattr(error.orig, "sqlite_errorcode", 0) & 0xFF
        return _BY_SQLITE_CODE.get(code, FailureKind.OTHER)
    unknown = FailureKind.UNREACHABLE if error.connection_invalidated else FailureKind.OTHER
    return kind_of_state(getattr(error.orig, "sqlstate", None)) or unknown


def kind_of_state(state: str | None) -> FailureKind | None:
    """Return what a code of PostgreSQL means, None if it says nothing about the database."""
    return next((kind for beginning, kind in _BY_SQLSTATE if (state or "").startswith(beginning)), None)
