"""A run's directory: whether it can be written, whose it is, and how its run began."""

import fcntl
import json
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import torch

from wrongturn_agents.training.checkpoint import read, versions
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.job import STATE
from wrongturn_agents.training.method import Method
from wrongturn_agents.training.settings import Settings

CONFIG: Final = "config.json"
BEST: Final = "best.pt"
LAST: Final = "last.pt"
ENCODER: Final = "encoder.pt"
_SEEDS: Final = 2**32


@dataclass(frozen=True)
class Begun:
    """Settings, seed and limits of a run."""

    settings: Settings
    seed: int
    steps: int | None
    minutes: float | None
    finished: bool = False
    """Whether the run came to its end."""

    def write(self, folder: Path, device: torch.device) -> None:
        """Write ``config.json``."""
        content = {
            "algorithm": self.settings.algorithm,
            "variant": self.settings.variant,
            "seed": self.seed,
            "steps": self.steps,
            "minutes": self.minutes,
            "finished": self.finished,
            "config": self.settings.as_dict(),
            "device": torch.cuda.get_device_name() if device.type == "cuda" else "cpu",
            "versions": versions(),
        }
        try:
            (folder / CONFIG).write_text(json.dumps(content, indent=1) + "\n", "utf-8")
        except OSError as error:
            raise _unwritable(folder, error) from error

    @classmethod
    def read(cls, folder: Path, method: Method) -> "Begun":
        """Read ``config.json`` of a method's run."""
        path = folder / CONFIG
        if not path.is_file():
            raise TrainingError(f"directory {folder}: holds no run to resume; name the directory of one")
        damaged = f"directory {folder}: its {CONFIG} is damaged; put it back, or train in another"
        try:
            content: Any = json.loads(path.read_text("utf-8"))
            algorithm, fields, *rest = (content[name] for name in ("algorithm", "config", "seed", "steps", "minutes"))
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise TrainingError(damaged) from error
        limits = all(value is None or (isinstance(value, int | float) and value > 0) for value in rest[1:])
        if not (isinstance(algorithm, str) and isinstance(fields, dict) and isinstance(rest[0], int) and limits):
            raise TrainingError(damaged)
        if algorithm != method.name:
            raise TrainingError(
                f"directory {folder}: holds a run of {algorithm}; resume it with 'wrongturn train {algorithm}', or "
                "name another directory"
            )
        try:
            begun = cls(method.settings.of(fields), *rest)
            return replace(begun, finished=content.get("finished") is True)
        except TrainingError as error:
            raise TrainingError(f"directory {folder}: {CONFIG}: {error}") from error


@contextmanager
def held(folder: Path, *, resume: bool) -> Iterator[None]:
    """Lock a directory while the block runs. The directory is made if it is missing.

    A run that has saved nothing cannot continue, so another run may start in its place.
    """
    if not resume:
        refuse_to_lose(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            directory = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise _unwritable(folder, error) from error
    try:
        # Lock the directory itself: there is no lock file to clean up, and the end of the process releases it.
        try:
            fcntl.flock(directory, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise TrainingError(
                f"directory {folder}: another process trains there; wait for its end, or name another"
            ) from error
        yield
    finally:
        os.close(directory)


def refuse_to_lose(folder: Path) -> None:
    """Check that a run can begin in a directory without overwriting another."""
    try:
        there = {path.name for path in folder.iterdir()} if folder.exists() else set()
    except OSError as error:
        raise _unwritable(folder, error) from error
    if STATE in there:
        raise TrainingError(f"directory {folder}: holds a run already; resume it (--resume), or name another")
    lost = [name for name in (BEST, LAST, ENCODER) if name in there]
    if lost:
        raise TrainingError(
            f"directory {folder}: holds another run's {lost[0]}; move it away, or name another directory"
        )


def _unwritable(folder: Path, error: OSError) -> TrainingError:
    return TrainingError(
        f"directory {folder}: cannot be written ({error.strerror or error}); name another by --directory"
    )


def read_state(folder: Path) -> dict[str, Any]:
    """Return the state from which a run continues."""
    path = folder / STATE
    if not path.is_file():
        raise TrainingError(f"resume: the run in {folder} has saved nothing to go on from; begin it without --resume")
    found = read(path, "resume:", "the directory of another run, or begin anew in another directory")
    if not isinstance(found, dict) or not found.keys() >= {"seconds", "begun"}:
        raise TrainingError(f"resume: {path} is damaged; begin anew in another directory")
    return found


def check_seed(seed: int) -> None:
    """Check a run's seed."""
    if not 0 <= seed < _SEEDS:
        raise TrainingError(f"seed: is {seed}; give a whole number from 0 to {_SEEDS - 1}")


def check_resumed(options: Sequence[str], seed: int | None, own: int) -> None:
    """Check what is given again with ``--resume``."""
    if options:
        raise TrainingError(f"option {options[0]!r}: the run has its own options; give none with --resume")
    if seed is not None and seed != own:
        raise TrainingError(f"seed: the run has seed {own}, not {seed}; leave --seed out with --resume")
