"""The folder with the models of submissions. Names are the submissions' ids, never a client's words."""

import os
from pathlib import Path
from typing import Final

from wrongturn_service.storage.location import OWNER_ALONE
from wrongturn_service.storage.submissions import SubmissionStore

_FOLDER_MODE: Final = 0o700


class ModelFiles:
    """Models on disk: ``<id>.part`` while one arrives, ``<id>.onnx`` once it is complete.

    Methods that touch many bytes are plain functions: use a thread.
    """

    def __init__(self, home: Path) -> None:
        self.folder = home / "submissions"

    def prepare(self) -> None:
        """Create the folder, and delete what uploads left when the service ended last. Raises OSError."""
        self.folder.mkdir(parents=True, mode=_FOLDER_MODE, exist_ok=True)
        for part in self.folder.glob("su_*.part"):
            part.unlink()

    def path(self, submission_id: str) -> Path:
        """Return the path of a complete model."""
        return self.folder / f"{submission_id}.onnx"

    def begin(self, submission_id: str) -> int:
        """Create the file of a model that arrives, and return its descriptor. Raises OSError."""
        return os.open(self._part(submission_id), os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, OWNER_ALONE)

    def keep(self, submission_id: str, handle: int) -> None:
        """Put a model that has arrived on disk for good, under its name. Raises OSError."""
        os.fsync(handle)
        self._part(submission_id).rename(self.path(submission_id))
        folder = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def delete(self, submission_id: str) -> None:
        """Delete a complete model. Safe to call more than once."""
        self.path(submission_id).unlink(missing_ok=True)

    def delete_part(self, submission_id: str) -> None:
        """Delete what has arrived of a model. Safe to call more than once."""
        self._part(submission_id).unlink(missing_ok=True)

    async def purge(self, rows: SubmissionStore, before: float) -> int:
        """Delete the models of submissions that were over before a time, and old ones that no submission has.

        A model without a row is kept as long: the database may have been put back from a backup that is too old.

        Args:
            rows: The submissions.
            before: Seconds since 1970.

        Returns:
            The number of deleted models.
        """
        written = {file.stem: file.stat().st_mtime for file in self.folder.glob("su_*.onnx")}
        ended = {**written, **await rows.ended(written)}
        old = [name for name, end in ended.items() if end is not None and end < before]
        for name in old:
            self.delete(name)
        return len(old)

    def _part(self, submission_id: str) -> Path:
        return self.folder / f"{submission_id}.part"
