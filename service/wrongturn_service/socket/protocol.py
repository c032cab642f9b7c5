"""The short way of a WebSocket's binary messages: from the socket to whoever answers, and back from where they lie.

Uvicorn's own way, by the library's parser, a queue, ASGI's events and a joined copy of each reply, takes several times
as long as all else that a step costs the service. The library keeps everything that is not a whole binary message: the
handshake, fragments, text, pings, the close and whatever is malformed.
"""

from collections.abc import Callable, Sequence
from typing import Any, Final

from typing_extensions import override
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.http11 import Request
from websockets.protocol import State

from wrongturn_protocol import framing
from wrongturn_service.simulators.frames import write_now

EXTENSION: Final = "wrongturn.direct"
"""Where the ASGI scope's extensions have the connection, for the application to take."""


class DirectWebSocket(WebSocketsSansIOProtocol):
    """Uvicorn's WebSocket, whose binary messages an application may take for itself."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._taker: Callable[[bytes], None] | None = None
        self._busy = False
        self._pending = bytearray()
        self._wanted = 0
        self._fragmented = False
        self._hopeless = False
        self._handle = -1
        self._recall: Callable[[], None] | None = None
        self._afterwards: Callable[[], None] | None = None

    # What the application uses

    def take(self, taker: Callable[[bytes], None]) -> None:
        """Have binary messages given to somebody as they come, instead of to ASGI's ``receive``; before it accepts."""
        self._taker = taker
        self._handle = self.transport.get_extra_info("socket").fileno()

    def set_busy(self, busy: bool) -> None:
        """Whether no more is to be read for now."""
        if busy != self._busy:
            self._busy = busy
            self._pace()

    def send_message(self, pieces: Sequence[bytes | memoryview]) -> None:
        """Send a binary message; the pieces are the caller's again when this returns.

        Nothing is sent any more once the connection closes.
        """
        if self.conn.state is not State.OPEN or self.close_sent or self.transport.is_closing():
            return
        length = sum(map(len, pieces))
        write_now(self.transport, self._handle, (framing.head(length), *pieces))

    def lend(self, recall: Callable[[], None]) -> int | None:
        """Let another process read and write, until it is called back or gives it back by itself.

        Args:
            recall: calls it back.

        Returns:
            The file descriptor; None where it cannot be lent: it is encrypted, closes, or something is half done.
        """
        if (
            self.conn.state is not State.OPEN
            or self.close_sent
            or self.scheme != "ws"
            or self.read_paused
            or self.incomplete
            or self.transport.is_closing()
            or self.transport.get_write_buffer_size()
        ):
            return None
        self._recall = recall
        self._pace()
        return self._handle

    def take_back(self, unread: bytes, unsent: bytes, *, broken: bool) -> None:
        """Go on where the other process has stopped.

        Args:
            unread: what it has read and not answered.
            unsent: what is left of its last reply.
            broken: whether the connection is of no more use: nobody knows what was read, or sent of a reply.
        """
        self._recall = None
        if broken or self.transport.is_closing():
            self.transport.abort()
            return
        self._pending += unread
        if unsent:
            self.transport.write(unsent)
        if self._afterwards is None:
            self._pace()
        else:
            self._afterwards()

    # What uvicorn and its transport use

    @property
    def incomplete(self) -> bool:
        """Whether a message has begun to come."""
        return bool(self.frames or self._pending or self.conn.reader.buffer)

    @override
    def handle_connect(self, event: Request) -> None:
        super().handle_connect(event)
        extensions: dict[str, Any] | None = None if self.close_sent else self.scope["extensions"]
        if extensions is not None:
            extensions[EXTENSION] = self

    @override
    def data_received(self, data: bytes) -> None:
        if not self.handshake_initiated or self._hopeless:
            super().data_received(data)
        elif self._pending:
            self._pending += data
            if len(self._pending) >= self._wanted and not self.read_paused:
                whole, self._pending = self._pending, bytearray()
                self._split(whole)
        else:
            self._split(data)

    @override
    def send_receive_event_to_app(self) -> None:
        if self._taker is None or self.curr_msg_data_type == "text" or self.close_sent:
            super().send_receive_event_to_app()
            return
        message = b"".join(self.frames)
        self.frames = []
        self._taker(message)

    @override
    def connection_lost(self, exc: Exception | None) -> None:
        if self._recall is not None:
            self._recall()  # else the socket would stay open there
        super().connection_lost(exc)

    @override
    def shutdown(self) -> None:
        self._once_back(super().shutdown)

    @override
    def keepalive_timeout(self) -> None:
        self._once_back(super().keepalive_timeout)

    @override
    def send_keepalive_ping(self) -> None:
        if self._recall is None:
            super().send_keepalive_ping()
        else:
            self.schedule_ping()  # it would get between the other process's frames; who steps is alive

    @override
    def pause_writing(self) -> None:
        super().pause_writing()
        self._pace()

    @override
    def resume_writing(self) -> None:
        super().resume_writing()
        self._pace()

    def _once_back(self, end: Callable[[], None]) -> None:
        """End the connection, not in the middle of what another process says."""
        if self._recall is None:
            end()
        else:
            self._afterwards = end
            self._recall()

    def _pace(self) -> None:
        """Read no more while calls are being answered, or replies not taken."""
        if self._taker is None:
            return
        held = self._busy or self._recall is not None or not self.writable.is_set()
        if held and not self.read_paused:
            self.read_paused = True
            self.transport.pause_reading()
        elif self.read_paused and not held:
            self.read_paused = False
            self.transport.resume_reading()
            # What came with the last message; not from within whatever freed the way.
            self.loop.call_soon(self.data_received, b"")

    def _split(self, data: bytes | bytearray) -> None:
        """Take whole frames; what is left waits for the rest."""
        at = 0
        while at < len(data) and not self.read_paused:
            begin, end = framing.extent(data, at, len(data))
            if self.config.ws_max_size < end - begin:
                # Refused by its head alone, which nothing follows.
                self._hopeless = True
                super().data_received(bytes(data[at:]))
                return
            if end > len(data):
                self._wanted = end - at
                break
            kind = data[at]
            if (
                kind == framing.BINARY
                and data[at + 1] & framing.MASKED
                and self._taker is not None
                and not self._fragmented
            ):
                if self.conn.state is State.OPEN:
                    self._taker(framing.apply_mask(data[begin:end], data[begin - 4 : begin]))
            else:
                if not kind & framing.CONTROL:
                    self._fragmented = not kind & framing.FINAL
                super().data_received(bytes(data[at:end]))
            at = end
        else:
            self._wanted = 0
        self._pending += data[at:]
