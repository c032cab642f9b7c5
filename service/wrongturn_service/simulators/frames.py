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
_PIECE: Final = 1 << 16
"""Bytes that are asked of a blocking socket at a time."""
OK: Final = 0
"""A reply's first item: it worked."""
REFUSED: Final = 1
"""A reply's first item: the trial cannot be driven as asked."""
FAILED: Final = 2
"""A reply's first item: the simulation broke."""


def pack(value: object) -> bytes:
    """A value as one frame."""
    body: bytes = msgpack.packb(value)
    return _HEAD.pack(len(body)) + body


class Splitter:
    """Takes bytes as they come, gives values as they are complete."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Any]:
        """The values that are complete with this piece."""
        if not self._buffer and len(data) > _HEAD.size and _HEAD.unpack_from(data)[0] == len(data) - _HEAD.size:
            return [msgpack.unpackb(memoryview(data)[_HEAD.size :])]  # as nearly always: all of one, and no more
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
    """Gives the values of a blocking socket."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._splitter = Splitter()
        self._values: deque[Any] = deque()
        self._handle: int | None = None

    @property
    def waiting(self) -> bool:
        """Whether a value has come that nobody has received."""
        return bool(self._values)

    def take_handle(self) -> int:
        """The file descriptor that came with the last value, the caller's from now on."""
        handle, self._handle = self._handle, None
        assert handle is not None
        return handle

    def receive(self) -> Any:
        """The next value.

        Raises:
            EOFError: the other side is gone.
        """
        while not self._values:
            data, handles, _, _ = socket.recv_fds(self._connection, _PIECE, 1)
            if not data:
                raise EOFError
            if handles:
                (self._handle,) = handles
            self._values.extend(self._splitter.feed(data))
        return self._values.popleft()


def write_now(transport: asyncio.WriteTransport, handle: int, pieces: Sequence[bytes | memoryview]) -> None:
    """Hand bytes to the kernel at once, from where they lie; what it does not take is copied for the transport.

    Args:
        transport: of a plain stream.
        handle: the file descriptor beneath it.
        pieces: what is written, one after the other; the caller's again when this returns.
    """
    sent = 0
    if transport.get_write_buffer_size() == 0 and not transport.is_closing():
        # What goes wrong here goes wrong for the transport too, which tells its protocol.
        with contextlib.suppress(OSError):
            sent = os.writev(handle, pieces)
    left = []
    for piece in pieces:
        if sent < len(piece):
            left.append(memoryview(piece)[sent:])
        sent = max(0, sent - len(piece))
    if left:
        transport.write(b"".join(left))
