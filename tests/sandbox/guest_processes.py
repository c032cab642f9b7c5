"""A listener as a process, and looks at processes of this machine."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil


def children(pid: int | None = None) -> list[int]:
    """Return the processes that a process, this one if none is named, has started, and theirs."""
    return [child.pid for child in psutil.Process(pid).children(recursive=True)]


def bubblewrap_and_guest() -> tuple[int, int]:
    """Return the processes of the one sandbox under bubblewrap that this process has opened."""
    (bubblewrap,) = [child for child in psutil.Process().children() if child.name() == "bwrap"]
    return bubblewrap.pid, children(bubblewrap.pid)[-1]


def gone(pid: int) -> bool:
    """Return whether a process has ended."""
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def wait_until(true: Callable[[], bool]) -> None:
    """Wait until something is true."""
    while not true():
        time.sleep(0.01)


class ListenerProcess:
    """The program of a runner container, which a test may kill; with guests of its own where a command is given."""

    def __init__(self, folder: Path, most: int = 8, command: list[str] | None = None) -> None:
        self.path = folder / "runner.sock"
        line = [sys.executable, "-m", "wrongturn_sandbox", "--listen", str(self.path), "--most", str(most)]
        if command is not None:
            program = (
                "import sys; from pathlib import Path; from wrongturn_sandbox.listener import Listener; "
                f"Listener(Path({str(self.path)!r}), {most}, {command!r}).run()"
            )
            line = [sys.executable, "-c", program]
        environment = {**os.environ, "SECRET": "of the listener"}
        self.process = subprocess.Popen(line, stderr=subprocess.DEVNULL, env=environment)
        self.wait_until(self.path.exists)

    def wait_until(self, true: Callable[[], bool]) -> None:
        while not true():
            assert self.process.poll() is None, "the listener ended"
            time.sleep(0.01)

    def guests(self) -> list[int]:
        return children(self.process.pid)

    def end(self) -> None:
        self.process.terminate()
        self.process.wait()
