"""What an upload of the corpus is."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path


class By(StrEnum):
    """Who finds out."""

    SIZE = "size"
    """The limit on an upload's size, before anything reads it."""
    CHECK = "check"
    """The check, by reading the file alone."""
    LOAD = "load"
    """The sandbox, when onnxruntime loads the model, or the file takes too much to read."""
    STEP = "step"
    """The sandbox, at a step."""
    CONTRACT = "contract"
    """The contract of a model, outside the sandbox: at its description or at an action."""


@dataclass(frozen=True)
class Case:
    """One upload."""

    name: str
    make: Callable[[], bytes]
    """Makes the file's first bytes."""
    words: str
    """Words that the reason holds, in any case of letters."""
    by: By = By.CHECK
    length: int | None = None
    """Length of the file where it is longer than its first bytes. The rest is a hole."""

    def write(self, folder: Path) -> Path:
        """Write the file into a folder, and return its path."""
        file = folder / f"{self.name}.onnx"
        with file.open("wb") as out:
            out.write(self.make())
            if self.length is not None:
                out.truncate(self.length)
        return file
