"""The processes of a campaign: one a job, each on a GPU that it may share."""

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Final

from wrongturn_agents.training.bundle import replace
from wrongturn_agents.training.campaign_plan import SCORING, Job
from wrongturn_agents.training.job import DONE
from wrongturn_agents.training.progress_file import read_rows

_TRIES: Final = 2
"""A job that fails is tried once more: from where it was, where there is such a place."""
_TOLD: Final = ("step", "minutes", "reward_mean", "success_heldout")


@dataclass
class JobProcess:
    """A job of a campaign, whether it waits, runs or is over."""

    job: Job
    folder: Path
    gpu: int | None = None
    """Index among the campaign's while it runs."""
    tries: int = 0
    began: float = 0.0
    """Seconds of the monotonic clock."""
    process: "subprocess.Popen[bytes] | None" = field(default=None, repr=False)

    @property
    def done(self) -> bool:
        """Whether all of it is there."""
        return (self.folder / DONE).is_file()

    @property
    def running(self) -> bool:
        """Whether a process is at it."""
        return self.process is not None

    @property
    def waiting(self) -> bool:
        """Whether it is to be begun."""
        return not self.done and not self.running and self.tries < _TRIES

    @property
    def state(self) -> str:
        """In a word."""
        if self.running:
            return "running"
        return "done" if self.done else "waiting" if self.waiting else "failed"

    @property
    def needs(self) -> float:
        """Minutes that it takes from where it is."""
        rows = self._rows()
        trained = (self.folder / "run" / "state.pt").is_file() and rows
        return max(SCORING, self.job.needs - (float(rows[-1]["minutes"]) if trained else 0.0))

    def start(self, gpu: int, command: dict[str, Any], device: str | None) -> None:
        """Begin, or go on.

        Args:
            gpu: index among the campaign's.
            command: what ``job.json`` says beside the job.
            device: what ``CUDA_VISIBLE_DEVICES`` names; None on the CPU.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        replace(self.folder / "job.json", json.dumps({"job": self.job.as_dict(), **command}, indent=1).encode())
        self.gpu, self.tries, self.began = gpu, self.tries + 1, time.monotonic()
        threads = str(min(4, command["threads"]))
        more = {} if device is None else {"CUDA_VISIBLE_DEVICES": device}
        with (self.folder / "log.txt").open("ab") as log:
            self.process = _module("job", [str(self.folder)], log, {"OMP_NUM_THREADS": threads, **more})

    def over(self) -> int | None:
        """Its exit status, once it has ended; it does not run any more then."""
        status = self.process.poll() if self.process else None
        if status is not None:
            self.process, self.gpu = None, None
        return status

    def terminate(self) -> None:
        """Ask it to end, without waiting for it."""
        if self.process is not None:
            self.process.terminate()

    def stop(self, patience: float = 5.0) -> None:
        """End it; what it has written stays, and it goes on from there another time."""
        if self.process is None:
            return
        self.terminate()
        try:
            self.process.wait(patience)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.process, self.gpu = None, None

    def told(self) -> dict[str, Any]:
        """For the status: its state, and the last of each figure of its curve."""
        rows = self._rows()
        last = {name: next((row[name] for row in reversed(rows) if row.get(name)), None) for name in _TOLD}
        figures = {name: float(value) for name, value in last.items() if value is not None}
        reverted = sum(float(row.get("reverted") or 0.0) for row in rows)
        return {"state": self.state, "gpu": self.gpu, **figures, **({"reverted": reverted} if reverted else {})}

    def _rows(self) -> list[dict[str, str]]:
        return [row for row in read_rows(self.folder / "run" / "progress.csv") if row.get("minutes")]


def warm_up(log: IO[bytes], seconds: float) -> int:
    """Compile what all jobs need before they begin; gives the exit status."""
    process = _module("job", ["--warm"], log, {})
    try:
        return process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()


def _module(name: str, arguments: list[str], log: IO[bytes], more: dict[str, str]) -> "subprocess.Popen[bytes]":
    environment = {**os.environ, "PYTHONUNBUFFERED": "1", "PYTHONWARNINGS": "ignore", **more}
    command = [sys.executable, "-m", f"wrongturn_agents.training.{name}", *arguments]
    return subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=environment)  # noqa: S603 - our own
