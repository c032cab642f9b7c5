"""Files that one process holds at a time; whatever becomes of it, they are free when it has ended."""

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from wrongturn_agents.training.errors import TrainingError


@contextmanager
def locked(path: Path, busy: str | None = None) -> Iterator[None]:
    """Hold a file while the block is run.

    Args:
        path: of the file; made where it is missing.
        busy: what to say where another process holds it; without, it is waited for.

    Raises:
        TrainingError: another process holds it.
    """
    with path.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | (0 if busy is None else fcntl.LOCK_NB))
        except OSError as error:
            raise TrainingError(f"{path.parent}: {busy}; end it first") from error
        yield
