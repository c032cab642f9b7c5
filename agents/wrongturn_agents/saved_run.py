"""What an interrupted run is resumed from: its file, and the database of its own service."""

import hashlib
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from wrongturn_agents.errors import AgentImportError, RunFileError
from wrongturn_client.closing import Closing
from wrongturn_protocol.home import home
from wrongturn_protocol.json_output import write_whole

_FILE: Final = "wrongturn.db"
_PREFIX: Final = "database-"
_A_DAY: Final = 24 * 3600.0


class SavedRun(BaseModel):
    """An evaluation, and what its worker needs to resume it. Only its owner may read the file: it holds a token."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    agent: str
    """Agent as the user named it; the path of a file is absolute."""
    name: str | None
    """Name on the leaderboard; None if the agent was registered before, under the user's own token."""
    suite: str
    evaluation: str
    token: str
    url: str | None
    """URL of the service; None for one that the worker starts."""
    database: Path | None = None
    """Folder with the database of a service that the worker starts."""
    keep: bool = False
    """Whether that database is kept after the run."""
    code: dict[str, str] = Field(default_factory=dict)
    """SHA-256 of the files of the agent's code, by path, when the run began."""

    @property
    def path(self) -> Path:
        """Path of the file."""
        return directory() / f"{self.evaluation}.json"

    def changed(self, code: Iterable[Path]) -> list[str]:
        """Return the files of the agent's code that were changed, added or taken away since the run began, sorted."""
        now = checksums(code) if self.code else {}
        return sorted(file for file in self.code.keys() | now.keys() if self.code.get(file) != now.get(file))

    def save(self) -> Path:
        """Write the file with mode 0600, and return its path. Raises RunFileError."""
        with _writing(self.path):
            directory().mkdir(mode=0o700, parents=True, exist_ok=True)
            write_whole([self.model_dump_json(indent=2).encode(), b"\n"], self.path, private=True)
        return self.path

    def forget(self) -> None:
        """Remove the file, after which the run cannot be resumed."""
        with _writing(self.path):
            self.path.unlink(missing_ok=True)

    @classmethod
    def load(cls, named: str) -> Self:
        """Read a run by its file or by the id of its evaluation, for ``--resume``.

        Raises:
            RunFileError: There is no such file, or it is not a saved run.
        """
        path = Path(named)
        if not path.is_file() and path.name == named:
            path = directory() / f"{named}.json"
        try:
            return cls.model_validate_json(path.read_text(encoding="utf-8"))
        except OSError as error:
            known = ", ".join(sorted(file.stem for file in directory().glob("*.json"))) or "none"
            raise RunFileError(
                f"--resume: no run {named!r} ({path}: {error.strerror}); runs known here: {known}"
            ) from error
        except (ValidationError, UnicodeDecodeError) as error:
            raise RunFileError(
                f"--resume: {path} is not a saved run; name a file that 'wrongturn run' wrote"
            ) from error


def checksums(files: Iterable[Path]) -> dict[str, str]:
    """Return the SHA-256 of each file by its path.

    Raises:
        AgentImportError: A file cannot be read.
    """
    found = {}
    for file in files:
        try:
            with file.open("rb") as opened:
                found[str(file.resolve())] = hashlib.file_digest(opened, "sha256").hexdigest()
        except OSError as error:
            raise AgentImportError(f"agent: {file} cannot be read ({error.strerror})") from error
    return found


def ensure_directory() -> None:
    """Create the directory of saved runs, and check that files can be created in it. Raises RunFileError."""
    with _writing(directory()):
        ensure_folder(directory())


def ensure_folder(folder: Path) -> None:
    """Create a folder that only its owner may read, and check that files can be created in it. Raises OSError."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder):
        pass


def directory() -> Path:
    """Return the directory of saved runs: ``runs`` in ``WRONGTURN_HOME``."""
    return home() / "runs"


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Turn errors of writing into RunFileError."""
    try:
        yield
    except OSError as error:
        raise RunFileError(
            f"{path}: cannot be written ({error.strerror}); let WRONGTURN_HOME name a writable directory"
        ) from error


class RunDatabase(Closing):
    """A folder with a database, which is removed at the end of the ``with`` block unless it is still needed.

    It is beside the saved runs, so that an interrupted run can be resumed. A new one removes what killed runs
    left behind: folders that no saved run names and that have not changed for a day.

    Args:
        folder: Folder of a run that is resumed; None for a new one.

    Raises:
        RunFileError: The folder is gone, or a new one cannot be made.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.needed = folder is not None
        if folder is None:
            ensure_directory()
            _remove_unneeded()
            folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=directory())).resolve()
        elif not (folder / _FILE).is_file():
            raise RunFileError(f"the database of that run is gone ({folder}); drive the suite again")
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


def _remove_unneeded() -> None:
    named = "".join(file.read_text(encoding="utf-8", errors="replace") for file in directory().glob("*.json"))
    for folder in directory().glob(f"{_PREFIX}*"):
        written = max(one.stat().st_mtime for one in (folder, *folder.iterdir()))
        if folder.name not in named and time.time() - written > _A_DAY:
            shutil.rmtree(folder, ignore_errors=True)
