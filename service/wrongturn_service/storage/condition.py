"""What is known of the database's condition: which failures there were, and whether it works now."""

import sqlite3
import time
from collections.abc import Callable
from enum import StrEnum
from typing import Final

import structlog
from sqlalchemy.exc import DBAPIError, IntegrityError, SQLAlchemyError


class FailureKind(StrEnum):
    """Why a transaction failed, with what the service says of it in public. The log has the database's own words."""

    sentence: str

    def __new__(cls, value: str, sentence: str = "") -> "FailureKind":
        """Make a member from its value and its sentence."""
        kind = str.__new__(cls, value)
        kind._value_, kind.sentence = value, sentence
        return kind

    FULL = "full", "its disk is full"
    IO = "io", "its disk or file system fails"
    READ_ONLY = "read-only", "it is read-only"
    BUSY = "busy", "another program has locked it"
    DAMAGED = "damaged", "it is damaged"
    GONE = "gone", "its file was deleted, moved or replaced"
    TAKEN = "taken", "another service has taken it"
    UNREACHABLE = "unreachable", "its server does not answer"
    OTHER = "other"


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
_BY_SQLSTATE: Final = {
    ("53100",): FailureKind.FULL,
    ("25006",): FailureKind.READ_ONLY,
    ("57014", "55P03"): FailureKind.BUSY,
    ("XX001", "XX002"): FailureKind.DAMAGED,
    ("58",): FailureKind.IO,
    ("53", "57", "08"): FailureKind.UNREACHABLE,
}
"""PostgreSQL's codes, by their beginnings. The first that fits counts."""


class StorageError(SQLAlchemyError):
    """Base of the storage's own errors."""

    kind: FailureKind


class Condition:
    """Follows the transactions of a database. ``failed`` is called with the kind of each one that failed."""

    def __init__(self, failed: Callable[[str], None] = lambda _: None) -> None:
        self._count = failed
        self._failure: FailureKind | None = None
        self.writing_since: float | None = None
        """When the write in progress began, by ``time.monotonic()``."""
        self._log = structlog.get_logger("storage")

    @property
    def trouble(self) -> str | None:
        """Why the database cannot be used now, as a sentence; None if nothing is known against it."""
        if self._failure is not None:
            return self._failure.sentence
        if self.writing_since is None or time.monotonic() - self.writing_since < STUCK_S:
            return None
        return f"a write has not ended within {STUCK_S:g} s"

    @property
    def failing(self) -> bool:
        """Whether a transaction failed, and no write has succeeded since."""
        return self._failure is not None

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
        self._count(kind)
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
        return _BY_SQLITE_CODE.get(getattr(error.orig, "sqlite_errorcode", 0) & 0xFF, FailureKind.OTHER)
    unknown = FailureKind.UNREACHABLE if error.connection_invalidated else FailureKind.OTHER
    return kind_of_state(getattr(error.orig, "sqlstate", None)) or unknown


def kind_of_state(state: str | None) -> FailureKind | None:
    """Return what a code of PostgreSQL means, None if it says nothing about the database."""
    return next((kind for beginnings, kind in _BY_SQLSTATE.items() if (state or "").startswith(beginnings)), None)
