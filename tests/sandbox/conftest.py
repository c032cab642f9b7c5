import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

# The helpers beside these tests are imported by their plain names.
sys.path.insert(0, str(Path(__file__).parent))

StartListener = Callable[..., Path]


def _wait_for(path: Path, process: subprocess.Popen[bytes]) -> None:
    while not path.exists():
        assert process.poll() is None, "the listener ended"
        time.sleep(0.01)


@pytest.fixture(scope="session")
def start_listener(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StartListener]:
    """Start a listener, with guests of its own where a command is given, and return its socket."""
    started: list[subprocess.Popen[bytes]] = []

    def start(most: int = 8, command: list[str] | None = None) -> Path:
        path = tmp_path_factory.mktemp("run") / "runner.sock"
        line = [sys.executable, "-m", "wrongturn_sandbox", "--listen", str(path), "--most", str(most)]
        if command is not None:
            program = (
                "import sys; from pathlib import Path; from wrongturn_sandbox.listener import Listener; "
                f"Listener(Path({str(path)!r}), {most}, {command!r}).run()"
            )
            line = [sys.executable, "-c", program]
        process = subprocess.Popen(line, stderr=subprocess.DEVNULL, env={**os.environ, "SECRET": "of the listener"})
        started.append(process)
        _wait_for(path, process)
        return path

    yield start
    for process in started:
        process.terminate()
        process.wait()


@pytest.fixture(scope="session")
def listener(start_listener: StartListener) -> Path:
    """The socket of a listener, as a runner container has it."""
    return start_listener()


@pytest.fixture(params=["bubblewrap", "listener"])
def place(request: pytest.FixtureRequest) -> Path | None:
    """Where a sandbox is opened: None for bubblewrap, or a listener's socket."""
    socket = request.getfixturevalue(request.param)
    assert socket is None or isinstance(socket, Path)
    return socket
