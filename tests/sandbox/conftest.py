import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

# The helpers beside these tests are imported by their plain names.
sys.path.insert(0, str(Path(__file__).parent))

StartListener = Callable[..., Path]


@pytest.fixture(scope="session")
def start_listener(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StartListener]:
    """Start a listener, with guests of its own where a command is given, and return its socket."""
    from guest_processes import ListenerProcess

    started: list[ListenerProcess] = []

    def start(most: int = 8, command: list[str] | None = None) -> Path:
        started.append(ListenerProcess(tmp_path_factory.mktemp("run"), most, command))
        return started[-1].path

    yield start
    for each in started:
        each.end()


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
