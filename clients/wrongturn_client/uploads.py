"""Multipart forms with a file that is read while it is sent, so that no model has to fit into memory."""

import io
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from wrongturn_client.errors import ModelFileError


@dataclass(frozen=True)
class Upload:
    """Form with one file, the last of its fields."""

    path: Path
    field: str
    """Name of the file's field."""
    fields: Mapping[str, str]
    """The other fields, which are sent before the file."""
    progress: Callable[[int, int], None] | None = None
    """Called with the numbers of sent and of all bytes of the file."""

    @contextmanager
    def open(self) -> Iterator[io.BufferedReader]:
        """Open the file at its start.

        Raises:
            ModelFileError: It cannot be opened or read.
        """
        try:
            with _CountedFile(io.FileIO(self.path), self.path.stat().st_size, self.progress) as file:
                yield file
        except OSError as error:
            raise ModelFileError(f"model: {self.path} cannot be read: {error.strerror or error}") from error


class _CountedFile(io.BufferedReader):
    """File that reports how far it has been read."""

    def __init__(self, raw: io.FileIO, size: int, progress: Callable[[int, int], None] | None) -> None:
        super().__init__(raw)
        self._size, self._progress = size, progress

    def read(self, size: int | None = -1, /) -> bytes:
        """Read bytes and report how many were read so far."""
        content = super().read(size)
        if self._progress is not None:
            self._progress(min(self.tell(), self._size), self._size)
        return content
