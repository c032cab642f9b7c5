"""Frames on a stream: four bytes of length, little-endian, then a msgpack value."""

import socket
import struct
from typing import Any, Final

import msgpack

_HEAD: Final = struct.Struct("<I")
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


def receive(connection: socket.socket) -> Any:
    """The next value of a blocking socket.

    Raises:
        EOFError: the other side is gone.
    """
    (length,) = _HEAD.unpack(_exactly(connection, _HEAD.size))
    return msgpack.unpackb(_exactly(connection, length))


def _exactly(connection: socket.socket, length: int) -> bytes:
    data = bytearray()
    while len(data) < length:
        piece = connection.recv(length - len(data))
        if not piece:
            raise EOFError
        data += piece
    return bytes(data)
