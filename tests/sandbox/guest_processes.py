"""A listener as a process, and looks at processes of this machine."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path


def children(pid: int) -> list[int]:
    """Return the processes that a process has started, and theirs."""
    threads = Path(f"/proc/{pid}/task").glob("*/children")
    found = [int(child) for thread in threads for child in thread.read_text().split()]
    return [*found, *(later for child in found for later in children(child))]


def gone(pid: int) -> bool:
    """Return whether a process has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
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
