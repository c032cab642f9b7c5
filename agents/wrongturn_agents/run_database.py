"""The database of a run's own service: made for one run, and thrown away after it."""

import shutil
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from wrongturn_agents.errors import RunFileError
from wrongturn_agents.saved_run import directory, ensure_directory

_FILE: Final = "wrongturn.db"


class RunDatabase:
    """A folder with a database that disappears at the end of the ``with`` block, unless somebody needs it again.

    It lies among the saved runs, so that an interrupted run can be resumed.

    Args:
        folder: Folder of a run that is resumed; None for a new one.

    Raises:
        RunFileError: The folder is gone, or a new one cannot be made.
    """

    def __init__(self, folder: Path | None = None) -> None:
        if folder is None:
            ensure_directory()
            folder = Path(tempfile.mkdtemp(prefix="database-", dir=directory())).resolve()
            self.needed = False
        elif not (folder / _FILE).is_file():
            raise RunFileError(f"the database of that run is gone ({folder}); drive the suite again")
        else:
            self.needed = True
        self.folder = folder
        """Its absolute path."""

    @property
    def url(self) -> str:
        """URL of the database, for ``wrongturn serve --database``."""
        return f"sqlite+aiosqlite:///{self.folder / _FILE}"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Remove the folder unless it is needed."""
        if not self.needed:
            shutil.rmtree(self.folder, ignore_errors=True)
