"""The database of a run's own service: made for one run, and thrown away after it."""

import shutil
import tempfile
from pathlib import Path
from typing import Final

from wrongturn_agents.errors import RunFileError
from wrongturn_agents.saved_run import directory, ensure_directory
from wrongturn_client.closing import Closing

_FILE: Final = "wrongturn.db"


class RunDatabase(Closing):
    """A folder with a database, which is removed at the end of the ``with`` block unless it is still needed.

    It is beside the saved runs, so that an interrupted run can be resumed.

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

    def close(self) -> None:
        """Remove the folder unless it is needed."""
        if not self.needed:
            shutil.rmtree(self.folder, ignore_errors=True)
