"""A host believes nothing that a guest says: a guest that a model has taken over can only be refused."""

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from upload_models import model

from wrongturn_sandbox import (
    Limits,
    ModelRefusedError,
    Sandbox,
    SandboxLostError,
    SandboxUnavailableError,
    open_sandbox,
)
from wrongturn_sandbox.frames import VERSION, FrameError, packed, receive, send, unpacked

SPEED = {"speed": np.zeros((1, 1), np.float32)}
LIMITS = Limits(memory=1 << 30, load_s=20, step_s=2)
FIELDS: dict[str, Any] = {"inputs": [], "outputs": [], "opset": 18, "metadata": {}, "nodes": 1, "parameters": 1}
HONEST = {"description": FIELDS}
READY = {"ready": VERSION, "runtime": "hostile"}
Play = Callable[[socket.socket], object]


@contextlib.contextmanager
def played(folder: Path, play: Play) -> Iterator[Path]:
    """A runner container's socket. Whoever connects speaks with a guest that this function plays."""
    path = folder / "runner.sock"
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))
        listening.listen()

        def guest() -> None:
            connection, _ = listening.accept()
            with connection, contextlib.suppress(OSError):
                play(connection)

        thread = threading.Thread(target=guest)
        thread.start()
        yield path
        thread.join()


@contextlib.contextmanager
def opened(folder: Path, play: Play) -> Iterator[Sandbox]:
    """A sandbox whose guest begins well, takes a model, and then does this."""

    def begin(connection: socket.socket) -> None:
        receive(connection, 1000)
        send(connection, packed(READY))
        receive(connection, 1000)
        receive(connection, 1 << 20)
        play(connection)

    with played(folder, begin) as path, open_sandbox(path, LIMITS) as sandbox:
        yield sandbox


def says(message: object) -> Play:
    return lambda connection: send(connection, packed(message))


@pytest.mark.parametrize(
    "play",
    [
        lambda connection: connection.sendall(b"\xff\xff\xff\xff" + b"x" * 1000),
        lambda connection: send(connection, b"\xc1 no msgpack"),
        lambda connection: send(connection, b"\x91" * 5_000_000),
        says(7),
        says({}),
        says({"shell": "rm -rf /"}),
        says({"description": 7}),
        says({"description": {"inputs": [["a", "object", [1]]]}}),
        says({"outputs": {}}),
        says({"refused": {"a": 1}}),
        says({"description": msgpack.ExtType(5, b"x")}),
        says({"description": {**FIELDS, "opset": -1}}),
        says({"description": {**FIELDS, "metadata": {"a": "x" * 1_000_000}}}),
        says({"ended": 0}),
        says({"ended": 9}),
    ],
)
def test_nonsense_instead_of_a_description(tmp_path: Path, play: Play) -> None:
    with opened(tmp_path, play) as sandbox, pytest.raises(ModelRefusedError) as refused:
        sandbox.load(model())
    assert len(str(refused.value)) < 500


@pytest.mark.parametrize(
    "message",
    [
        [[[] for _ in range(100)] for _ in range(100)],
        [{}] * 2000,
        list(range(100_000)),
        dict.fromkeys(map(str, range(1000)), 0),
        ["x" * (2 << 20)],
        msgpack.ExtType(5, b"x"),
    ],
)
def test_a_message_that_would_take_much_memory_is_not_unpacked(message: object) -> None:
    with pytest.raises(FrameError):
        unpacked(packed(message))


@pytest.mark.parametrize(
    "array",
    [
        ["object", [1], b"12345678"],
        ["float32", [2], b"1234"],
        ["float32", [-1], b"1234"],
        ["float32", [1 << 40, 1 << 40], b""],
        ["float32", [1.5], b"1234"],
        ["float32", [True], b"1234"],
        ["float32", [1] * 50, b"1234"],
        ["float32", [1], "1234"],
        ["float32", [1]],
        [],
        7,
        [["float32"], [1], b"1234"],
    ],
)
def test_nonsense_instead_of_an_array(tmp_path: Path, array: object) -> None:
    def play(connection: socket.socket) -> None:
        send(connection, packed(HONEST))
        receive(connection, 1 << 20)
        send(connection, packed({"outputs": {"steer": array}}))

    with opened(tmp_path, play) as sandbox:
        assert sandbox.load(model()).opset == 18
        with pytest.raises(ModelRefusedError, match="does not follow its protocol"):
            sandbox.run(SPEED)


def test_a_reason_cannot_write_on_a_terminal(tmp_path: Path) -> None:
    play = says({"refused": "\x1b[2Jevil\n\u202e" + "x" * 100_000})
    with opened(tmp_path, play) as sandbox, pytest.raises(ModelRefusedError, match="evil") as refused:
        sandbox.load(model())
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) <= 400


def test_drops_that_never_end_meet_the_deadline(tmp_path: Path) -> None:
    def play(connection: socket.socket) -> None:
        send(connection, packed(HONEST))
        connection.sendall(b"\0\0\x10\0")
        while True:
            connection.sendall(b"x")
            time.sleep(0.05)

    with opened(tmp_path, play) as sandbox:
        sandbox.load(model())
        with pytest.raises(ModelRefusedError, match="longer than 2 s"):
            sandbox.run(SPEED)


@pytest.mark.parametrize(
    "play", [says({"ended": -9}), lambda connection: connection.sendall(b"\0\0\0\x08cut"), lambda _: None]
)
def test_a_guest_that_may_have_been_killed_is_only_lost(tmp_path: Path, play: Play) -> None:
    with opened(tmp_path, play) as sandbox, pytest.raises(SandboxLostError):
        sandbox.load(model())


@pytest.mark.parametrize("play", [lambda _: None, lambda connection: connection.sendall(b"hello")])
def test_a_guest_that_does_not_get_ready(tmp_path: Path, play: Play) -> None:
    with played(tmp_path, play) as path, pytest.raises(SandboxUnavailableError, match="look at its log"):
        open_sandbox(path, LIMITS)
