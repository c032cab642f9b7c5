"""The listener of a runner container: a guest for each connection, which ends with it."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import msgpack
import numpy as np
import pytest
from corpus import CORPUS
from guest_processes import ListenerProcess, gone, wait_until
from upload_models import model

from wrongturn_sandbox import (
    Limits,
    ModelRefusedError,
    SandboxBusyError,
    SandboxLostError,
    SandboxUnavailableError,
    open_sandbox,
    probe,
)
from wrongturn_sandbox.frames import VERSION, receive, send

LIMITS = Limits(memory=1 << 30, load_s=60, step_s=60)
SPEED = {"speed": np.zeros((1, 1), np.float32)}
SLOW = next(case for case in CORPUS if case.name == "time-at-a-step")
StartListener = Callable[..., Path]


@pytest.fixture
def own(tmp_path: Path) -> Iterator[ListenerProcess]:
    made = ListenerProcess(tmp_path, 4)
    yield made
    made.process.kill()
    made.process.wait()


def test_only_owner_and_group_may_connect(listener: Path) -> None:
    assert listener.stat().st_mode & 0o777 == 0o660


def test_one_host_too_many_is_told(start_listener: StartListener) -> None:
    path = start_listener(most=2)
    taken = pytest.raises(SandboxBusyError, match="all 2 sandboxes of the runner container are taken")
    with open_sandbox(path, LIMITS), open_sandbox(path, LIMITS), taken:
        assert probe(path) == "runner container (all 2 sandboxes of the runner container are taken)"
        open_sandbox(path, LIMITS)


def test_a_guest_ends_with_its_connection(own: ListenerProcess) -> None:
    sandbox = open_sandbox(own.path, LIMITS)
    sandbox.load(SLOW.make())
    assert len(own.guests()) == 1
    sandbox._limits = Limits(memory=1 << 30, step_s=0.3)
    with pytest.raises(ModelRefusedError, match=r"longer than 0\.3 s"):
        sandbox.run(SPEED)
    own.wait_until(lambda: own.guests() == [])
    with open_sandbox(own.path, LIMITS) as another:
        assert another.load(model()).nodes == 2


def test_a_killed_guest_is_lost_and_the_others_go_on(own: ListenerProcess) -> None:
    with open_sandbox(own.path, LIMITS) as first:
        first.load(model())
        (pid,) = own.guests()
        with open_sandbox(own.path, LIMITS) as second:
            second.load(model())
            os.kill(pid, signal.SIGKILL)
            with pytest.raises(SandboxLostError, match="outside"):
                first.run(SPEED)
            assert second.run(SPEED)["steer"].tolist() == [[0]]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_guests_end_with_the_listener(own: ListenerProcess, number: signal.Signals) -> None:
    with open_sandbox(own.path, LIMITS) as sandbox:
        sandbox.load(model())
        (pid,) = own.guests()
        own.process.send_signal(number)
        own.process.wait()
        wait_until(lambda: gone(pid))
        with pytest.raises(SandboxLostError, match="outside"):
            sandbox.run(SPEED)
    assert own.path.exists() == (number == signal.SIGKILL)


def test_a_stale_socket_is_replaced_and_a_used_one_is_not(own: ListenerProcess, tmp_path: Path) -> None:
    line = [sys.executable, "-m", "wrongturn_sandbox", "--listen", str(own.path)]
    second = subprocess.run(line, capture_output=True, text=True, timeout=60, check=False)
    assert second.returncode == 1
    assert "cannot listen" in second.stderr
    own.process.kill()
    own.process.wait()
    assert own.path.exists()
    again = subprocess.Popen(line, stderr=subprocess.DEVNULL)
    try:
        wait_until(lambda: answers(own.path))
        assert list(tmp_path.iterdir()) == [own.path]
    finally:
        again.kill()
        again.wait()


def answers(path: Path) -> bool:
    try:
        return probe(path).startswith("runner container")
    except SandboxUnavailableError:
        return False


def test_a_file_that_is_no_socket_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "runner.sock").write_text("mine")
    line = [sys.executable, "-m", "wrongturn_sandbox", "--listen", str(tmp_path / "runner.sock")]
    ended = subprocess.run(line, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 1
    assert (tmp_path / "runner.sock").read_text() == "mine"


def test_another_version_is_named(listener: Path) -> None:
    with socket.socket(socket.AF_UNIX) as connection:
        connection.connect(str(listener))
        send(connection, msgpack.packb({"begin": 99, "memory": 1 << 30, "load_s": 1.0, "step_s": 1.0}))
        content = receive(connection, 10_000)
        assert content is not None
        assert f"versions 99 and {VERSION}" in msgpack.unpackb(content)["unavailable"]


def test_a_host_gets_the_place_of_one_that_left(start_listener: StartListener) -> None:
    path = start_listener(most=1)
    for _ in range(2):
        with open_sandbox(path, LIMITS) as sandbox:
            assert sandbox.load(model()).nodes == 2


def test_garbage_from_a_host_harms_no_other(own: ListenerProcess) -> None:
    for garbage in 3 * [b"", b"\xff" * 100, b"\0\0\0\x05hello", b"GET / HTTP/1.1\r\n\r\n"]:
        with socket.socket(socket.AF_UNIX) as connection:
            connection.connect(str(own.path))
            connection.sendall(garbage)
    assert probe(own.path).startswith("runner container")


def test_the_command_line_probes(listener: Path, tmp_path: Path) -> None:
    for path, status in ((listener, 0), (tmp_path / "nothing.sock", 1)):
        line = [sys.executable, "-m", "wrongturn_sandbox", "--probe", str(path)]
        ended = subprocess.run(line, capture_output=True, text=True, timeout=60, check=False)
        assert ended.returncode == status
        assert ("runner container" in ended.stdout) == (status == 0)
