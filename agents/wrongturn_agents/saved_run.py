"""What is kept of a run, so that it can go on after an interruption."""

import os
import tempfile
from pathlib import Path
from typing import Self

from pydantic import BaseModel, ConfigDict, ValidationError

from wrongturn_agents.errors import RunFileError
from wrongturn_client import settings


class SavedRun(BaseModel):
    """One evaluation, and what its worker needs to go on with it. Holds a token: only its owner may read it."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    agent: str
    """As the user named it; a file's path is absolute."""
    name: str | None
    """On the leaderboard; None where the user's own token says whose it is."""
    suite: str
    evaluation: str
    token: str
    url: str | None
    """Of the service; None for one of the worker's own, which is then started again."""

    @property
    def path(self) -> Path:
        """Where it is kept."""
        return directory() / f"{self.evaluation}.json"

    def save(self) -> Path:
        """Write it with mode 0600.

        Raises:
            RunFileError: it cannot be written.
        """
        try:
            directory().mkdir(mode=0o700, parents=True, exist_ok=True)
            handle = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(self.model_dump_json(indent=2) + "\n")
        except OSError as error:
            raise RunFileError(
                f"{self.path}: cannot be written ({error.strerror}); let WRONGTURN_HOME name a writable directory",
            ) from error
        return self.path

    @classmethod
    def load(cls, named: str) -> Self:
        """Read a run by its file or by its evaluation's id.

        Raises:
            RunFileError: there is none, or it is no run's file.
        """
        path = Path(named)
        if not path.is_file() and path.name == named:
            path = directory() / f"{named}.json"
        try:
            return cls.model_validate_json(path.read_text(encoding="utf-8"))
        except OSError as error:
            known = ", ".join(sorted(file.stem for file in directory().glob("*.json"))) or "none"
            raise RunFileError(
                f"--resume: no run {named!r} ({path}: {error.strerror}); runs known here: {known}",
            ) from error
        except (ValidationError, UnicodeDecodeError) as error:
            raise RunFileError(f"--resume: {path} is no run's file; name one that 'wrongturn run' wrote") from error


def ensure_directory() -> None:
    """Make the directory where runs are kept, and see that files can be made in it.

    Raises:
        RunFileError: they cannot.
    """
    try:
        directory().mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory()):
            pass
    except OSError as error:
        raise RunFileError(
            f"{directory()}: cannot be written ({error.strerror}); let WRONGTURN_HOME name a writable directory",
        ) from error


def directory() -> Path:
    """Where runs are kept: ``runs`` under ``WRONGTURN_HOME``."""
    return settings.home() / "runs"
