"""A shorter path for a WebSocket's binary messages: from the socket to whoever answers, and back without a copy.

Uvicorn's own path takes several times as long as everything else that a step costs the service: the library's parser,
a queue, ASGI's events, and a joined copy of each reply. The library keeps everything that is not a whole binary
message: the handshake, fragments, text, pings, the close, and malformed frames.

This module extends a private module of uvicorn's, so ``pyproject.toml`` names the versions that are tested.
"""

import contextlib
import os
from collections.abc import Callable, Sequence
from typing import Any, Final

from typing_extensions import override
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import CloseCode
from websockets.http11 import Request
from websockets.protocol import State

from wrongturn_protocol import ProblemType
from wrongturn_service.socket import framing
from wrongturn_service.socket.guards import Guard, GuardedWriting, Patience

_FRAMES: Final = 16
"""Most frames of a connection that are handled in one turn of the event loop."""
_BYTES: Final = 8192
"""Bytes of frames after which the connection waits for the loop's next turn."""
_PARTS: Final = 256
"""Most frames of a message."""
_CONTROLS: Final = 100
"""Most control frames within so many seconds."""
_CONTROLS_S: Final = 10.0
_LINGER_S: Final = 1.0
"""Seconds for which what a refused client still sends is read and dropped."""
EXTENSION: Final = "wrongturn.direct"
"""Name of the ASGI extension that gives the application the connection's :class:`DirectWebSocket`."""


class DirectWebSocket(GuardedWriting, WebSocketsSansIOProtocol):
    """Uvicorn's WebSocket within limits, whose binary messages an application can receive directly."""

    def __init__(self, *arguments: Any, guard: Guard, **named: Any) -> None:
        super().__init__(*arguments, guard=guard, **named)
        self._received = 0
        self._patience = Patience(guard, self._too_slow, lambda: self._received, lambda: self.read_paused)
        self._on_message: Callable[[bytes], None] | None = None
        self._busy = False
        self._pending = bytearray()
        self._wanted = 0
        self._fragmented = False
        self._parts = 0
        self._controls, self._controls_until = 0, 0.0
        self._behind = False
        self._refused = False
        self._handle = -1

    # For the application

    def receive_messages(self, on_message: Callable[[bytes], None]) -> None:
        """Call a function with each binary message, instead of queueing it. To be used before the handshake's end."""
        self._on_message = on_message
        self._handle = self.transport.get_extra_info("socket").fileno()

    def set_busy(self, busy: bool) -> None:
        """Stop reading for as long as the application is busy."""
        if busy != self._busy:
            self._busy = busy
            self._pace()

    def send_message(self, pieces: Sequence[bytes]) -> None:
        """Send a binary message in pieces, unless the connection is being closed."""
        if self.conn.state is not State.OPEN or self.close_sent or self.transport.is_closing():
            return
        message = [framing.head(sum(map(len, pieces))), *pieces]
        sent = 0
        if self.transport.get_write_buffer_size() == 0:
            # Without a copy, and before the end of the loop's turn. The transport meets the same errors.
            with contextlib.suppress(OSError):
                sent = os.writev(self._handle, message)
        if sent < sum(map(len, message)):
            self.transport.write(b"".join(message)[sent:])

    # For uvicorn and the transport

    @override
    def connection_lost(self, exc: Exception | None) -> None:
        self._patience.end()
        super().connection_lost(exc)

    @override
    def handle_connect(self, event: Request) -> None:
        super().handle_connect(event)
        extensions: dict[str, Any] | None = None if self.close_sent else self.scope["extensions"]
        if extensions is not None:
            extensions[EXTENSION] = self
            # Until the application accepts the connection, which reads on.
            self.read_paused = True
            self.transport.pause_reading()

    @override
    def data_received(self, data: bytes) -> None:
        self._received += len(data)
        if not self.handshake_initiated or self._refused:
            super().data_received(data)
        elif self._pending:
            self._pending += data
            if len(self._pending) >= self._wanted and not self.read_paused:
                whole, self._pending = self._pending, bytearray()
                self._split(whole)
        else:
            self._split(data)
        if self.frames or self._pending or self.conn.reader.buffer:  # a part of a message
            self._patience.begin()
        else:
            self._patience.end()

    @override
    def send_receive_event_to_app(self) -> None:
        if self._on_message is None or self.curr_msg_data_type == "text" or self.close_sent:
            super().send_receive_event_to_app()
            return
        message = b"".join(self.frames)
        self.frames = []
        self._on_message(message)

    @override
    def pause_writing(self) -> None:
        super().pause_writing()
        self._pace()

    @override
    def resume_writing(self) -> None:
        super().resume_writing()
        self._pace()

    def _pace(self) -> None:
        """Read only while the application is not busy and replies are taken."""
        if self._on_message is None:
            return
        paused = self._busy or self._behind or not self.writable.is_set()
        if paused and not self.read_paused:
            self.read_paused = True
            self.transport.pause_reading()
        elif self.read_paused and not paused:
            self.read_paused = False
            self.transport.resume_reading()
            # Messages that came with the last one; later, so that no message is handled within another one.
            self.loop.call_soon(self.data_received, b"")

    def _refuse(self, code: int, problem: ProblemType, reason: str) -> None:
        """Close the connection because of the frames that came, with a code and a problem's type."""
        self._guard.report(reason, self.transport)
        self._refused = True
        self.conn.fail(code, problem.value)
        self.transport.write(b"".join(self.conn.data_to_send()))
        self.close_sent = True
        # What is unread then would make the end come before the word.
        self.close_timer = self.loop.call_later(_LINGER_S, self.transport.close)

    def _too_slow(self) -> None:
        if not self.close_sent and not self.transport.is_closing():
            self._refuse(CloseCode.POLICY_VIOLATION, ProblemType.REQUEST_TIMEOUT, "slow-message")

    def _wait_a_turn(self) -> None:
        """Let other connections have their turn before the next frames of this one."""
        self._behind = True
        self._pace()
        self.loop.call_soon(self._go_on)

    def _go_on(self) -> None:
        self._behind = False
        self._pace()

    def _within_limits(self, kind: int) -> bool:
        """Count a frame that is not a whole message; close the connection if there are too many."""
        if kind & framing.CONTROL:
            if self.loop.time() > self._controls_until:
                self._controls, self._controls_until = 0, self.loop.time() + _CONTROLS_S
            self._controls += 1
            if self._controls > _CONTROLS:
                self._refuse(CloseCode.POLICY_VIOLATION, ProblemType.RATE_LIMITED, "too-many-frames")
                return False
            return True
        self._fragmented = not kind & framing.FINAL
        self._parts = self._parts + 1 if self._fragmented else 0
        if self._parts > _PARTS:
            self._refuse(CloseCode.MESSAGE_TOO_BIG, ProblemType.MESSAGE_TOO_LARGE, "too-many-frames")
            return False
        return True

    def _split(self, data: bytes | bytearray) -> None:
        """Handle whole frames; keep what follows them until the rest comes."""
        at = handled = 0
        while at < len(data) and not self.read_paused:
            if handled == _FRAMES or at > _BYTES:
                self._wanted = 0
                self._wait_a_turn()
                break
            handled += 1
            begin, end = framing.extent(data, at, len(data))
            if self.config.ws_max_size < end - begin:
                # The library refuses it by its head alone, and nothing after it counts.
                self._refused = True
                super().data_received(bytes(data[at:]))
                return
            if end > len(data):
                self._wanted = end - at
                break
            kind = data[at]
            if (
                kind == framing.BINARY
                and data[at + 1] & framing.MASKED
                and self._on_message is not None
                and not self._fragmented
            ):
                if self.conn.state is State.OPEN:
                    self._on_message(framing.apply_mask(data[begin:end], data[begin - 4 : begin]))
            elif self._within_limits(kind):
                super().data_received(bytes(data[at:end]))
            if self._refused or self.transport.is_closing():
                return
            at = end
        else:
            self._wanted = 0
        self._pending += data[at:]
