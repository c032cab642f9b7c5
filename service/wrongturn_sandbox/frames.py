"""Frames between processes of ours: four bytes of length, then msgpack or a model's bytes.

Host and guest send and receive them with a limit and a deadline: neither trusts the other's lengths.
"""

import math
import socket
import struct
import time
from typing import Any, Final

import msgpack

VERSION: Final = 3
"""Number of this protocol. Host and guest must have the same."""
MODEL_MOST: Final = 1 << 30
"""Largest model, bytes."""
CALL_MOST: Final = 16 << 20
"""Largest call of the host without a model, bytes: an observation and a state."""
REPLY_MOST: Final = 8 << 20
"""Largest reply of a guest, bytes: the outputs of a step, or a description."""
TEXT_MOST: Final = 1 << 20
"""Longest text in a message, bytes."""
ITEMS_MOST: Final = 128
"""Most items of a list or a map in a message."""
CONTAINERS_MOST: Final = 1024
"""Most lists and maps in a message. Each takes a hundred bytes of memory, and may have come as one."""
_AT_ONCE: Final = 1 << 20
_HEADER: Final = struct.Struct("!I")


class FrameError(Exception):
    """What came is no frame, or a longer one than this side takes."""


class CutOffError(FrameError):
    """The connection was closed in the midst of a frame."""


class DeadlineError(Exception):
    """The other side did not send or take a whole frame in time."""


def send(connection: socket.socket, payload: bytes | bytearray | memoryview, deadline: float = math.inf) -> None:
    """Send a frame, by a deadline of ``time.monotonic()``. Raises DeadlineError, OSError."""
    try:
        _wait_until(connection, deadline)
        header = _HEADER.pack(len(payload))
        if len(payload) <= _AT_ONCE:  # a frame in one piece is hardly ever cut off by the sender's end
            connection.sendall(header + payload)
            return
        connection.sendall(header)
        _wait_until(connection, deadline)
        connection.sendall(payload)
    except TimeoutError:
        raise DeadlineError from None


def receive(connection: socket.socket, most: int, deadline: float = math.inf) -> bytearray | None:
    """Return a frame's content of at most so many bytes, or None when the other side has closed the connection.

    Raises DeadlineError, FrameError if the frame is too long, CutOffError, OSError.
    """
    header = _exactly(connection, _HEADER.size, deadline)
    if header is None:
        return None
    (length,) = _HEADER.unpack(header)
    if length > most:
        raise FrameError(f"a frame of {length} bytes; at most {most} are taken")
    content = _exactly(connection, length, deadline)
    if content is None:
        raise CutOffError("a frame without its content")
    return content


def packed(message: object) -> bytes:
    """Return a message as msgpack."""
    return bytes(msgpack.packb(message))


def unpacked(content: bytes | bytearray) -> Any:
    """Return a message of msgpack. Raises FrameError if it is none, or one that would take too much memory."""
    containers = 0

    def counted(container: Any) -> Any:
        nonlocal containers
        containers += 1
        if containers > CONTAINERS_MOST:
            raise FrameError
        return container

    try:
        return msgpack.unpackb(
            content,
            strict_map_key=True,
            object_hook=counted,
            list_hook=counted,
            max_str_len=TEXT_MOST,
            max_array_len=ITEMS_MOST,
            max_map_len=ITEMS_MOST,
            max_ext_len=0,
        )
    except Exception as error:  # msgpack raises many classes, ValueError and its own among them
        raise FrameError(f"no msgpack: {type(error).__name__}") from None


def _wait_until(connection: socket.socket, deadline: float) -> None:
    if deadline == math.inf:
        return
    remaining = deadline - time.monotonic()
    if remaining <= 0:
        raise DeadlineError
    connection.settimeout(remaining)


def _exactly(connection: socket.socket, length: int, deadline: float) -> bytearray | None:
    content = bytearray(length)
    view = memoryview(content)
    filled = 0
    while filled < length:
        try:
            _wait_until(connection, deadline)
            taken = connection.recv_into(view[filled:])
        except TimeoutError:
            raise DeadlineError from None
        if not taken:
            if filled:
                raise CutOffError("a frame that was cut off")
            return None
        filled += taken
    return content
