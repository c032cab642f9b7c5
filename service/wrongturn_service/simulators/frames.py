"""Frames on a stream: four bytes of length, little-endian, then a msgpack value."""

import asyncio
import contextlib
import os
import socket
import struct
from collections import deque
from collections.abc import Sequence
from typing import Any, Final

import msgpack

_HEAD: Final = struct.Struct("<I")
_READ_SIZE: Final = 1 << 16
OK: Final = 0
"""First item of a reply to a request that worked."""
REFUSED: Final = 1
"""First item of a reply that refuses a trial."""
FAILED: Final = 2
"""First item of a reply that says that the simulation failed."""


def pack(value: object) -> bytes:
    """Return a value as one frame."""
    body: bytes = msgpack.packb(value)
    return _HEAD.pack(len(body)) + body


class Splitter:
    """Splits a stream into values."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Any]:
        """Take the next bytes of the stream, and return the values that are complete with them."""
        if not self._buffer and len(data) > _HEAD.size and _HEAD.unpack_from(data)[0] == len(data) - _HEAD.size:
            return [msgpack.unpackb(memoryview(data)[_HEAD.size :])]  # nearly always: exactly one frame
        self._buffer += data
        values = []
        while len(self._buffer) >= _HEAD.size:
            (length,) = _HEAD.unpack_from(self._buffer)
            end = _HEAD.size + length
            if len(self._buffer) < end:
                break
            with memoryview(self._buffer) as whole, whole[_HEAD.size : end] as body:
                values.append(msgpack.unpackb(body))
            del self._buffer[:end]
        return values


class Receiver:
    """Receives values, and file descriptors beside them, from a blocking socket."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._splitter = Splitter()
        self._values: deque[Any] = deque()
        self._handle: int | None = None

    def fileno(self) -> int:
        """Return the socket's file descriptor."""
        return self._connection.fileno()

    @property
    def waiting(self) -> bool:
        """Whether a value can be received without reading from the socket."""
        return bool(self._values)

    def take_handle(self) -> int:
        """Return the file descriptor that came with the last value; the caller closes it."""
        handle, self._handle = self._handle, None
        assert handle is not None
        return handle

    def receive(self) -> Any:
        """Return the next value.

        Raises:
            EOFError: the other side has closed the stream.
        """
        while not self._values:
            data, handles, _, _ = socket.recv_fds(self._connection, _READ_SIZE, 1)
            if not data:
                raise EOFError
            if handles:
                (self._handle,) = handles
            self._values.extend(self._splitter.feed(data))
        return self._values.popleft()


def write_now(transport: asyncio.WriteTransport, handle: int, pieces: Sequence[bytes | memoryview]) -> None:
    """Write pieces without copying them first; the transport gets a copy of what the kernel does not take at once.

    Args:
        transport: of an unencrypted stream.
        handle: the stream's file descriptor.
        pieces: bytes to write one after the other; they may change as soon as this returns.
    """
    sent = 0
    if transport.get_write_buffer_size() == 0 and not transport.is_closing():
        # The transport meets the same error, and tells its protocol.
        with contextlib.suppress(OSError):
            sent = os.writev(handle, pieces)
    left = []
    for piece in pieces:
        if sent < len(piece):
            left.append(memoryview(piece)[sent:])
        sent = max(0, sent - len(piece))
    if left:
        transport.write(b"".join(left))
