"""One of several runs: a program of its own, whose log is in its directory. It needs no torch to be started.

``python -m wrongturn_agents.training.job train …`` is that program: ``wrongturn``, which ends with who started it.
"""

import ctypes
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

STATE: Final = "state.pt"
"""Name of the file in a run's directory that it resumes from."""
LOG: Final = "log.txt"
"""Name of the file in a run's directory that has what it prints."""
_TAIL: Final = 4096
"""Bytes of the log that are looked at, of its end."""
_PR_SET_PDEATHSIG: Final = 1


@dataclass(frozen=True)
class Job:
    """One run: an algorithm with one seed."""

    name: str
    folder: Path
    arguments: tuple[str, ...]
    """Arguments of ``wrongturn train`` that a run and its resumption have in common."""
    options: tuple[str, ...]
    """Settings of a run that begins."""
    beside: Path
    """Directory of which relative paths in the options are, if it is there."""

    def start(self, **environment: str) -> subprocess.Popen[bytes]:
        """Start its program: it resumes if the directory holds a run. The log grows by what it prints."""
        known = (self.folder / STATE).is_file()
        more = ("--resume",) if known else tuple(word for one in self.options for word in ("--option", one))
        with (self.folder / LOG).open("ab") as log:
            return subprocess.Popen(  # noqa: S603 - our own program
                [sys.executable, "-m", __spec__.name, "train", *self.arguments, *more],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,  # Ctrl-C reaches it through stop alone
                cwd=self.beside if self.beside.is_dir() else None,
                env={**os.environ, "PYTHONUNBUFFERED": "1", **environment},
            )

    def said(self) -> str:
        """Return the last line of the log, without the algorithm's name."""
        try:
            with (self.folder / LOG).open("rb") as log:
                log.seek(max(0, log.seek(0, os.SEEK_END) - _TAIL))
                lines = log.read().decode(errors="replace").split("\n")
        except OSError:
            return ""
        line = next((line.strip() for line in reversed(lines) if line.strip()), "")
        return line.removeprefix(f"{self.arguments[0]}: ")


class Started(Protocol):
    """A job that was started."""

    def failure(self) -> str | None:
        """Return why it failed, an empty text if it ended well, and None while it runs."""

    def stop(self, *, now: bool) -> None:
        """Let it save and end; or end it now."""


def failure_of(job: Job, code: int) -> str:
    """Return why a job's program failed, by its exit status; an empty text if it did not."""
    if code < 0:
        return f"ended by {signal.Signals(-code).name}"
    return (job.said() or f"exit status {code}") if code else ""


def main() -> None:
    """Be ``wrongturn``, and end with the process that started this one."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    from wrongturn_client.cli import main as program  # noqa: PLC0415 - only as a program

    program()


if __name__ == "__main__":
    main()
