"""The database of a run's own service: made for one run, and thrown away after it."""

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from wrongturn_agents.errors import RunFileError
from wrongturn_agents.saved_run import directory, ensure_directory
from wrongturn_client.closing import Closing

_FILE: Final = "wrongturn.db"
_PREFIX: Final = "database-"


class RunDatabase(Closing):
    """A folder with a database, which is removed at the end of the ``with`` block unless it is still needed.

    It is beside the saved runs, so that an interrupted run can be resumed. Its run keeps it locked. A new
    one removes those that killed runs have left.

    Args:
        folder: Folder of a run that is resumed; None for a new one.

    Raises:
        RunFileError: The folder is gone, or a new one cannot be made.
    """

    def __init__(self, folder: Path | None = None) -> None:
        if folder is None:
            ensure_directory()
            with _alone():
                _remove_unneeded()
                folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=directory())).resolve()
                self._lock = _locked(folder)
            self.needed = False
        elif not (folder / _FILE).is_file():
            raise RunFileError(f"the database of that run is gone ({folder}); drive the suite again")
        else:
            self._lock = _locked(folder)
            self.needed = True
        self.folder = folder
        """Its absolute path."""

    @property
    def url(self) -> str:
        """URL of the database, for ``wrongturn serve --database``."""
        return f"sqlite+aiosqlite:///{self.folder / _FILE}"

    def close(self) -> None:
        """Remove the folder unless it is needed."""
        if not self.needed:
            shutil.rmtree(self.folder, ignore_errors=True)
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def _remove_unneeded() -> None:
    """Remove the databases that no saved run names and no run that goes on has locked."""
    named = [file.read_text(encoding="utf-8", errors="replace") for file in directory().glob("*.json")]
    for folder in directory().glob(f"{_PREFIX}*"):
        if any(folder.name in text for text in named):
            continue
        lock = _locked(folder)
        if lock is not None:
            shutil.rmtree(folder, ignore_errors=True)
            os.close(lock)


def _locked(folder: Path) -> int | None:
    """Lock a folder and return the descriptor that holds the lock; None if another run has it."""
    with contextlib.suppress(OSError):  # some file systems have no locks: nothing is removed there
        opened = os.open(folder, os.O_RDONLY)
        try:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(opened)
            raise
        return opened
    return None


@contextlib.contextmanager
def _alone() -> Iterator[None]:
    """Let no other run make or remove a database during the ``with`` block."""
    opened = os.open(directory(), os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(opened, fcntl.LOCK_EX)
        yield
    finally:
        os.close(opened)
