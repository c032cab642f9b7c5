"""One WebSocket connection to ``/v1/drive``, blocking, on a plain socket.

Whole binary messages are framed here, all else by the websockets library without its own input and output: its
blocking client hands each message from one thread to another, and its parser copies what was read, each of which took
longer than all the rest of a step.
"""

import contextlib
import os
import socket
import ssl
from typing import Final, NoReturn
from urllib.parse import SplitResult

from websockets.client import ClientProtocol
from websockets.datastructures import Headers
from websockets.exceptions import InvalidHandshake, InvalidMessage, InvalidState, InvalidStatus
from websockets.frames import Frame, Opcode
from websockets.http11 import Response
from websockets.protocol import State
from websockets.typing import Subprotocol
from websockets.uri import parse_uri

from wrongturn_client.connections import Answer, ConnectionBrokeError
from wrongturn_client.errors import NotOfferedError
from wrongturn_client.problems import own_problem
from wrongturn_client.transport import check
from wrongturn_protocol import framing
from wrongturn_protocol.wire import PATH, SUBPROTOCOL

_PIECE: Final = 1 << 18
"""Bytes that are read at a time, into memory that stays: to have new memory each time took longer than to read."""
_MASKS: Final = 4096
"""Random bytes that are drawn at a time."""
_SWITCHED: Final = b"HTTP/1.1 101 "
_HEAD_END: Final = b"\r\n\r\n"
_CLOSE_TIMEOUT: Final = 1.0
_BUSY: Final = frozenset({429, 502, 503, 504})
_ANSWERS: Final = _BUSY | {401}
"""Refusals of the handshake that say nothing of whether there is such a socket."""


class WebSocketConnection:
    """A connection that is open; :meth:`receive` and :meth:`send` are for one thread."""

    def __init__(self, url: SplitResult, token: str | None, timeout: float, *, offered: bool = False) -> None:
        """Connect and shake hands.

        Args:
            url: of the service, ``http`` or ``https``.
            token: the bearer token.
            timeout: seconds for each wait.
            offered: the socket was there before. Then whatever answers and is no Wrongturn service stands in for one
                that is away.

        Raises:
            ConnectionBrokeError: nobody is there.
            NotOfferedError: somebody is there, and not this socket.
            ApiError: the service refuses.
        """
        secure = url.scheme == "https"
        self._socket = _connected(url, timeout, secure=secure)
        self._message: list[bytes] = []
        self._events: list[Frame] = []
        self._memory = memoryview(bytearray(_PIECE))
        self._begin = self._end = 0
        self._fragmented = False
        self._masks, self._mask_at = b"", 0
        self._head = bytearray()
        target = url._replace(scheme="wss" if secure else "ws", path=url.path + PATH).geturl()
        self._protocol = ClientProtocol(parse_uri(target), subprotocols=[Subprotocol(SUBPROTOCOL)], max_size=None)
        try:
            self._shake_hands(token, offered=offered)
        except BaseException:
            self._socket.close()
            raise

    def send(self, data: bytes) -> None:
        """Send a message. Raises ConnectionBrokeError."""
        try:
            if self._protocol.state is not State.OPEN:
                raise ConnectionBrokeError(self._why_closed())
            mask = self._mask()
            self._socket.sendall(framing.head(len(data), masked=True) + mask + framing.apply_mask(data, mask))
        except OSError as error:
            raise ConnectionBrokeError(str(error) or type(error).__name__) from error

    def _mask(self) -> bytes:
        """Four bytes that nobody can foresee; drawn for many messages at a time."""
        if self._mask_at == len(self._masks):
            self._masks, self._mask_at = os.urandom(_MASKS), 0
        begin = self._mask_at
        self._mask_at = end = begin + 4
        return self._masks[begin:end]

    def receive(self) -> bytes | memoryview:
        """The next message; what is read is good until the next is asked for. Raises ConnectionBrokeError."""
        while True:
            while self._events:
                frame = self._events.pop(0)
                if frame.opcode in {Opcode.BINARY, Opcode.TEXT, Opcode.CONT}:
                    self._message.append(bytes(frame.data))
                    if frame.fin:
                        whole, self._message = b"".join(self._message), []
                        return whole
            if self._protocol.state is not State.OPEN:
                raise ConnectionBrokeError(self._why_closed())
            message = self._taken()
            if message is not None:
                return message

    def close(self) -> None:
        """Say goodbye, where there is somebody, and close."""
        with contextlib.suppress(OSError, InvalidState):
            self._socket.settimeout(_CLOSE_TIMEOUT)
            self._protocol.send_close(1000)
            self._flush()
        self._socket.close()

    def _shake_hands(self, token: str | None, *, offered: bool) -> None:
        request = self._protocol.connect()
        request.headers["User-Agent"] = "wrongturn-client"
        if token:
            request.headers["Authorization"] = f"Bearer {token}"
        self._protocol.send_request(request)
        try:
            self._flush()
            while self._protocol.state is State.CONNECTING and self._protocol.handshake_exc is None:
                self._read_head()
        except OSError as error:
            raise ConnectionBrokeError(str(error) or type(error).__name__) from error
        failure = self._protocol.handshake_exc
        if isinstance(failure, InvalidStatus):
            _refused(failure.response, offered=offered)
        if isinstance(failure, InvalidHandshake) and not offered and not _ended(failure):
            raise NotOfferedError(f"no WebSocket at {PATH}: {failure}") from failure
        if failure is not None:
            raise ConnectionBrokeError(f"the handshake failed: {failure}") from failure
        if self._protocol.subprotocol != SUBPROTOCOL:
            raise NotOfferedError(f"the WebSocket at {PATH} speaks another protocol than {SUBPROTOCOL}")

    def _taken(self) -> memoryview | None:
        """The next message where it has come and is whole; else read more, or let the library have what is no such."""
        at = self._begin
        begin, end = framing.extent(self._memory, at, self._end)
        if end > self._end:
            self._read(end - at)
            return None
        kind = self._memory[at]
        self._begin = end
        if kind == framing.BINARY and not self._fragmented and not self._memory[at + 1] & framing.MASKED:
            return self._memory[begin:end]
        if not kind & framing.CONTROL:
            self._fragmented = not kind & framing.FINAL
        self._give(bytes(self._memory[at:end]))
        return None

    def _read(self, wanted: int) -> None:
        """Take what comes next, with room for so many bytes from the frame's first."""
        left = self._end - self._begin
        if not left:
            self._begin = self._end = 0
        if self._begin + wanted > len(self._memory):
            before = self._memory[self._begin : self._end]
            self._memory = memoryview(bytearray(max(wanted, _PIECE)))
            self._memory[:left] = before
            self._begin, self._end = 0, left
        try:
            count = self._socket.recv_into(self._memory[self._end :])
        except OSError as error:
            raise ConnectionBrokeError(str(error) or type(error).__name__) from error
        self._end += count
        if not count:
            self._give(b"")

    def _read_head(self) -> None:
        """Give the library the answer to the handshake, and nothing of what may follow it."""
        data = self._socket.recv(_PIECE)
        self._head += data
        end = self._head.find(_HEAD_END)
        if end >= 0 and self._head.startswith(_SWITCHED):
            after = self._head[end + len(_HEAD_END) :]
            self._memory[: len(after)] = after
            self._end = len(after)
            data = data[: len(data) - len(after)]
        self._give(data)

    def _give(self, data: bytes) -> None:
        """Let the library have bytes, none at the end of the stream, and answer pings."""
        try:
            if data:
                self._protocol.receive_data(data)
            else:
                self._protocol.receive_eof()
            self._events += [event for event in self._protocol.events_received() if isinstance(event, Frame)]
            self._flush()
        except OSError as error:
            raise ConnectionBrokeError(str(error) or type(error).__name__) from error

    def _flush(self) -> None:
        for data in self._protocol.data_to_send():
            if data:
                self._socket.sendall(data)
            else:
                with contextlib.suppress(OSError):
                    self._socket.shutdown(socket.SHUT_WR)

    def _why_closed(self) -> str:
        closed = self._protocol.close_rcvd
        return "the connection ended" if closed is None else f"closed with {closed.code} {closed.reason}".rstrip()


def _connected(url: SplitResult, timeout: float, *, secure: bool) -> socket.socket:
    host = url.hostname or ""
    try:
        plain = socket.create_connection((host, url.port or (443 if secure else 80)), timeout)
    except OSError as error:
        raise ConnectionBrokeError(str(error) or type(error).__name__) from error
    plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if not secure:
        return plain
    try:
        return ssl.create_default_context().wrap_socket(plain, server_hostname=host)
    except OSError as error:
        plain.close()
        raise ConnectionBrokeError(str(error) or type(error).__name__) from error


def _ended(failure: InvalidHandshake) -> bool:
    """Whether the connection ended before its answer did, as behind what takes connections for a service away."""
    return isinstance(failure, InvalidMessage) and isinstance(failure.__cause__, EOFError)


def _refused(response: Response, *, offered: bool) -> NoReturn:
    """Raise what a refused handshake says."""
    headers: Headers = response.headers
    status = response.status_code
    body = bytes(response.body or b"")
    told = f"no WebSocket of {SUBPROTOCOL} at {PATH}: status {status}"
    if offered and status not in _BUSY and not (400 <= status < 500 and own_problem(body)):
        raise ConnectionBrokeError(told)
    if status not in _ANSWERS:
        raise NotOfferedError(told)
    check(Answer(status, headers.get("content-type", ""), headers.get("location"), headers.get("retry-after"), body))
    raise AssertionError("these are errors")
