"""The folder with the models of submissions. Names are the submissions' ids, never a client's words."""

import contextlib
import fcntl
import hashlib
import os
from pathlib import Path
from typing import Final

from wrongturn_protocol import SubmissionState
from wrongturn_service.machine import check_disk
from wrongturn_service.storage.location import OWNER_ALONE
from wrongturn_service.storage.models import SubmissionRow
from wrongturn_service.storage.submissions import SubmissionStore

_FOLDER_MODE: Final = 0o700


class ModelFiles:
    """Models on disk: ``<id>.part`` while one arrives, ``<id>.onnx`` once it is complete.

    Methods that touch many bytes are plain functions: use a thread.
    """

    def __init__(self, home: Path, reserve: int = 0) -> None:
        """Use a home. Models leave so many bytes of its disk free, see :func:`check_disk`."""
        self.folder = home / "submissions"
        self._reserve = reserve

    def prepare(self) -> None:
        """Create the folder, and delete what uploads left when the service ended last. Raises OSError."""
        self.folder.mkdir(parents=True, mode=_FOLDER_MODE, exist_ok=True)
        for part in self.folder.glob("su_*.part"):
            # Another service may have the same home. What it receives now is locked.
            with part.open("rb") as left, contextlib.suppress(BlockingIOError):
                fcntl.flock(left, fcntl.LOCK_EX | fcntl.LOCK_NB)
                part.unlink()

    def path(self, submission_id: str) -> Path:
        """Return the path of a complete model."""
        return self.folder / f"{submission_id}.onnx"

    def check_room(self, size: int) -> None:
        """Check that so many bytes more leave the reserve of the disk free. Raises OSError (ENOSPC)."""
        check_disk(self.folder, self._reserve, size)

    def delete(self, submission_id: str) -> None:
        """Delete a complete model. Safe to call more than once."""
        self.path(submission_id).unlink(missing_ok=True)

    async def purge(self, rows: SubmissionStore, before: float) -> int:
        """Delete models that nobody needs, and return how many.

        Those are models of submissions that were never driven, of those that were over before a time (seconds since
        1970), and old ones that no submission has.

        A model without a row is kept as long: the database may have been put back from a backup that is too old.
        """
        written = {file.stem: file.stat().st_mtime for file in self.folder.glob("su_*.onnx")}
        known = {row.id: row for row in await rows.some(written)}
        useless = []
        for name, since in written.items():
            row = known.get(name)
            over = since if row is None else row.ended
            if (row is not None and never_driven(row)) or (over is not None and over < before):
                useless.append(name)
        for name in useless:
            self.delete(name)
            await rows.forget_model(name)
        return len(useless)


class ArrivingModel:
    """A model that is being received. Until it is kept, its file ends in ``.part``. Methods raise OSError."""

    def __init__(self, files: ModelFiles, submission_id: str) -> None:
        self._files = files
        self._to = files.path(submission_id)
        self._part = self._to.with_suffix(".part")
        self.hash = hashlib.sha256()
        self._handle: int | None = None

    def begin(self) -> None:
        """Create the file."""
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        self._handle = os.open(self._part, flags, OWNER_ALONE)
        fcntl.flock(self._handle, fcntl.LOCK_EX)

    def write(self, data: bytes) -> None:
        """Write and hash the next bytes."""
        assert self._handle is not None
        # Uploads at the same time may fill the disk that was free when each began.
        self._files.check_room(len(data))
        self.hash.update(data)
        left = memoryview(data)
        while left:
            left = left[os.write(self._handle, left) :]

    def keep(self) -> None:
        """Put the model on disk for good, under its name."""
        assert self._handle is not None
        os.fsync(self._handle)
        self._part.rename(self._to)
        folder = os.open(self._files.folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def close(self) -> None:
        """Close the file, and delete it unless it was kept."""
        if self._handle is not None:
            with contextlib.suppress(OSError):
                os.close(self._handle)
            self._handle = None
        self._part.unlink(missing_ok=True)


def never_driven(row: SubmissionRow) -> bool:
    """Return whether a submission is over and has no evaluation. Its model is of no use to anybody."""
    return SubmissionState(row.state).over and row.evaluation_id is None
