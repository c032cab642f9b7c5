"""Replies of a simulator process, and the quick ways to receive and to write its frames."""

import asyncio
import contextlib
import os
import socket
from collections import deque
from collections.abc import Sequence
from typing import Any, Final

from wrongturn_sandbox.frames import Splitter, pack

__all__ = ["FAILED", "OK", "REFUSED", "Receiver", "Splitter", "pack", "write_now"]
_READ_SIZE: Final = 1 << 16
OK: Final = 0
"""First item of a reply to a request that worked."""
REFUSED: Final = 1
"""First item of a reply that refuses a trial."""
FAILED: Final = 2
"""First item of a reply that says that the simulation failed."""


class Receiver:
    """Receives values from a blocking socket."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._splitter = Splitter()
        self._values: deque[Any] = deque()

    def receive(self) -> Any:
        """Return the next value.

        Raises:
            EOFError: the other side has closed the stream.
        """
        while not self._values:
            data = self._connection.recv(_READ_SIZE)
            if not data:
                raise EOFError
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
