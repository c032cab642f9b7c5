"""A host believes nothing that a guest says: a guest that a model has taken over can only be refused."""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from upload_models import model

from wrongturn_sandbox import Limits, ModelRefusedError, SandboxLostError, SandboxUnavailableError, open_sandbox

SPEED = {"speed": np.zeros((1, 1), np.float32)}
LIMITS = Limits(memory=1 << 30, load_s=20, step_s=2)
HONEST = {"description": {"inputs": [], "outputs": [], "opset": 18, "metadata": {}, "nodes": 1, "parameters": 1}}
GUEST = """
import msgpack, socket, sys
from wrongturn_sandbox.frames import packed, receive, send, unpacked
connection = socket.socket(fileno=int(sys.argv[1]))
receive(connection, 1000)
send(connection, packed({"ready": 1, "runtime": "hostile"}))
receive(connection, 1000)
receive(connection, 1 << 20)
"""


def opened(start_listener: Callable[..., Path], program: str) -> object:
    return open_sandbox(start_listener(command=[sys.executable, "-c", GUEST + program]), LIMITS)


@pytest.mark.parametrize(
    "reply",
    [
        'connection.sendall(b"\\xff\\xff\\xff\\xff" + b"x" * 1000)',
        'connection.sendall(b"\\0\\0\\0\\x08cut")',
        'send(connection, b"\\xc1 no msgpack")',
        'send(connection, b"\\x91" * 5_000_000)',
        "send(connection, packed(7))",
        "send(connection, packed({}))",
        'send(connection, packed({"shell": "rm -rf /"}))',
        'send(connection, packed({"description": 7}))',
        'send(connection, packed({"description": {"inputs": [["a", "object", [1]]]}}))',
        'send(connection, packed({"outputs": {}}))',
        'send(connection, packed({"refused": {"a": 1}}))',
        'send(connection, packed({"description": msgpack.ExtType(5, b"x")}))',
        'send(connection, packed({"description": {"inputs": [], "outputs": [], "opset": -1, "metadata": {}, '
        '"nodes": 1, "parameters": 1}}))',
        'send(connection, packed({"description": {"inputs": [], "outputs": [], "opset": 1, "metadata": {"a": "x" * '
        '1_000_000}, "nodes": 1, "parameters": 1}}))',
        "raise SystemExit(0)",
        "raise SystemExit(9)",
    ],
)
def test_nonsense_instead_of_a_description(start_listener: Callable[..., Path], reply: str) -> None:
    with opened(start_listener, reply) as sandbox, pytest.raises(ModelRefusedError) as refused:
        sandbox.load(model())
    assert len(refused.value.reason) < 500


@pytest.mark.parametrize(
    "array",
    [
        '["object", [1], b"12345678"]',
        '["float32", [2], b"1234"]',
        '["float32", [-1], b"1234"]',
        '["float32", [2 ** 40, 2 ** 40], b""]',
        '["float32", [1.5], b"1234"]',
        '["float32", [True], b"1234"]',
        '["float32", [1] * 50, b"1234"]',
        '["float32", [1], "1234"]',
        '["float32", [1]]',
        "[]",
        "7",
        '[["float32"], [1], b"1234"]',
    ],
)
def test_nonsense_instead_of_an_array(start_listener: Callable[..., Path], array: str) -> None:
    program = f"""
send(connection, packed({HONEST!r}))
receive(connection, 1 << 20)
send(connection, packed({{"outputs": {{"steer": {array}}}}}))
"""
    with opened(start_listener, program) as sandbox:
        assert sandbox.load(model()).opset == 18
        with pytest.raises(ModelRefusedError, match="does not follow its protocol"):
            sandbox.run(SPEED)


def test_a_reason_cannot_write_on_a_terminal(start_listener: Callable[..., Path]) -> None:
    program = 'send(connection, packed({"refused": "\\x1b[2Jevil\\n\\u202e" + "x" * 100_000}))'
    with opened(start_listener, program) as sandbox, pytest.raises(ModelRefusedError, match="evil") as refused:
        sandbox.load(model())
    assert refused.value.reason.isprintable()
    assert len(refused.value.reason) <= 400


def test_drops_that_never_end_meet_the_deadline(start_listener: Callable[..., Path]) -> None:
    program = f"""
import time
send(connection, packed({HONEST!r}))
connection.sendall(b"\\0\\0\\x10\\0")
while True:
    connection.sendall(b"x")
    time.sleep(0.05)
"""
    with opened(start_listener, program) as sandbox:
        sandbox.load(model())
        with pytest.raises(ModelRefusedError, match="longer than 2 s"):
            sandbox.run(SPEED)


def test_a_guest_that_says_it_was_killed_is_only_lost(start_listener: Callable[..., Path]) -> None:
    with opened(start_listener, 'send(connection, packed({"ended": -9}))') as sandbox, pytest.raises(SandboxLostError):
        sandbox.load(model())


@pytest.mark.parametrize("program", ["raise SystemExit(1)", "print('hello')"])
def test_a_guest_that_does_not_get_ready(start_listener: Callable[..., Path], program: str) -> None:
    path = start_listener(command=[sys.executable, "-c", program])
    with pytest.raises(SandboxUnavailableError, match="look at its log"):
        open_sandbox(path, LIMITS)
