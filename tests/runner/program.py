"""The program ``python -m wrongturn_runner``, run as the service runs it."""

import hashlib
import subprocess
import sys
import uuid
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import psutil

from wrongturn_client import Client, LocalService
from wrongturn_protocol import Track
from wrongturn_runner.messages import EVENT, CheckJob, DriveJob, Event, Job, PracticeJob

COMMAND = (sys.executable, "-m", "wrongturn_runner")
SUITE = "smoke@3"


class Runner:
    """A runner and the ends of its streams; the ``with`` block ends it."""

    def __init__(self, folder: Path, command: tuple[str, ...] = COMMAND) -> None:
        self._log = folder / "runner.log"
        with self._log.open("wb") as log:
            self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.process.stdout):
            assert stream is not None
            stream.close()

    def tell(self, message: Job | PracticeJob) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(message.model_dump_json().encode() + b"\n")
        self.process.stdin.flush()

    def hear(self) -> Event | None:
        """Return the next event; None after the last one."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        return EVENT.validate_json(line) if line else None

    def events(self) -> list[Event]:
        """Return all events up to the last one."""
        return list(iter(self.hear, None))

    def close_stdin(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()

    def status(self, timeout_s: float = 120.0) -> int:
        return self.process.wait(timeout_s)

    @property
    def log(self) -> str:
        """What it wrote to stderr."""
        return self._log.read_text()

    def sandboxes(self) -> list[psutil.Process]:
        """Return the processes below the runner."""
        return psutil.Process(self.process.pid).children(recursive=True)


def stored(folder: Path, model: bytes) -> dict[str, Any]:
    """Write a model and return the fields of a job that name it."""
    file = folder / "model.onnx"
    file.write_bytes(model)
    return {"model": file, "sha256": hashlib.sha256(model).hexdigest(), "memory": 2 << 30}


def check_of(folder: Path, model: bytes, url: str, *tracks: Track) -> CheckJob:
    return CheckJob(**stored(folder, model), tracks=tracks or (Track.CAMERA, Track.PRIVILEGED), url=url)


def drive_of(folder: Path, model: bytes, service: LocalService) -> DriveJob:
    """Begin an evaluation and return the job of driving it."""
    with Client(service.url) as client:
        token = client.register(f"driven {uuid.uuid4().hex[:8]}", Track.PRIVILEGED).token
    with Client(service.url, token) as client:
        evaluation = client.create_evaluation(SUITE).id
    return DriveJob(**stored(folder, model), url=service.url, token=token, evaluation=evaluation, suite=SUITE)


def failing(folder: Path, job: DriveJob | CheckJob) -> str:
    """Return the log of a runner that ends with status 1, without an event."""
    with Runner(folder) as runner:
        runner.tell(job)
        assert runner.events() == []
        assert runner.status() == 1
        return runner.log
