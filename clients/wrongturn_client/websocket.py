"""One WebSocket connection to ``/v1/drive``, blocking, on a plain socket.

This module frames whole binary messages itself and leaves all other frames to the websockets library, of which it uses
only the protocol. The library's blocking client hands each message from one thread to another, and its parser copies
the data; each of these takes longer than the rest of a step.
"""

import contextlib
import os
import socket
import ssl
from typing import Final, NoReturn
from urllib.parse import SplitResult

from pydantic import ValidationError
from websockets.client import ClientProtocol
from websockets.exceptions import InvalidHandshake, InvalidMessage, InvalidState, InvalidStatus
from websockets.frames import Frame, Opcode
from websockets.http11 import Response
from websockets.protocol import State
from websockets.typing import Subprotocol
from websockets.uri import parse_uri

from wrongturn_client.errors import NotOfferedError
from wrongturn_client.transport import Answer, ConnectionBrokeError
from wrongturn_protocol import Problem, ProblemType, framing
from wrongturn_protocol.wire import PATH, SUBPROTOCOL

_PIECE: Final = 1 << 18
"""Bytes read at a time, into memory that is kept: allocating it each time takes longer than reading."""
_SWITCHED: Final = b"HTTP/1.1 101 "
_HEAD_END: Final = b"\r\n\r\n"
_CLOSE_TIMEOUT: Final = 1.0
_BUSY: Final = frozenset({429, 502, 503, 504})
_ANSWERS: Final = _BUSY | {401}
"""Refusals that do not tell whether there is such a WebSocket."""


class WebSocketConnection:
    """Open connection; only one thread may use it."""

    def __init__(self, url: SplitResult, token: str | None, timeout: float, *, offered: bool = False) -> None:
        """Connect and shake hands.

        ``offered``: the WebSocket was there before. Any other answer then comes from something that stands in for the
        service, such as a proxy, so the service counts as away: ConnectionBrokeError.
        """
        secure = url.scheme == "https"
        self._socket = _connected(url, timeout, secure=secure)
        self._message: list[bytes] = []
        self._events: list[Frame] = []
        self._memory = memoryview(bytearray(_PIECE))
        self._begin = self._end = 0
        self._fragmented = False
        self._head = bytearray()
        target = url._replace(scheme="wss" if secure else "ws", path=url.path + PATH).geturl()
        self._protocol = ClientProtocol(parse_uri(target), subprotocols=[Subprotocol(SUBPROTOCOL)], max_size=None)
        try:
            self._shake_hands(token, offered=offered)
        except BaseException:
            self._socket.close()
            raise

    def send(self, data: bytes) -> None:
        """Send a message; raise OSError if that fails."""
        if self._protocol.state is not State.OPEN:
            raise ConnectionBrokeError(self._why_closed())
        mask = os.urandom(4)
        self._socket.sendall(framing.head(len(data), masked=True) + mask + framing.apply_mask(data, mask))

    def receive(self) -> bytes | memoryview:
        """Return the next message, which is valid until the next call; raise OSError if that fails."""
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
        """Send a close frame if possible, and close."""
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
        self._flush()
        while self._protocol.state is State.CONNECTING and self._protocol.handshake_exc is None:
            self._read_head()
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
        """Return the next message if it is complete; else read more, or pass any other frame to the library."""
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
        """Read what comes next; make room for a frame of ``wanted`` bytes."""
        left = self._end - self._begin
        if not left:
            self._begin = self._end = 0
        if self._begin + wanted > len(self._memory):
            before = self._memory[self._begin : self._end]
            self._memory = memoryview(bytearray(max(wanted, _PIECE)))
            self._memory[:left] = before
            self._begin, self._end = 0, left
        count = self._socket.recv_into(self._memory[self._end :])
        self._end += count
        if not count:
            self._give(b"")

    def _read_head(self) -> None:
        """Pass the answer to the handshake to the library, without the bytes that may follow it."""
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
        """Pass bytes to the library (none at the end of the stream), and send its answers to pings."""
        if data:
            self._protocol.receive_data(data)
        else:
            self._protocol.receive_eof()
        self._events += [event for event in self._protocol.events_received() if isinstance(event, Frame)]
        self._flush()

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
    plain = socket.create_connection((host, url.port or (443 if secure else 80)), timeout)
    plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if not secure:
        return plain
    try:
        return ssl.create_default_context().wrap_socket(plain, server_hostname=host)
    except OSError:
        plain.close()
        raise


def _ended(failure: InvalidHandshake) -> bool:
    """Tell whether the connection ended within the answer, as with a forwarder whose service is away."""
    return isinstance(failure, InvalidMessage) and isinstance(failure.__cause__, EOFError)


def _refused(response: Response, *, offered: bool) -> NoReturn:
    """Raise the error for a refused handshake."""
    status = response.status_code
    body = bytes(response.body or b"")
    reason = f"no WebSocket of {SUBPROTOCOL} at {PATH}: status {status}"
    if offered and status not in _BUSY and not (400 <= status < 500 and _is_own_problem(body)):
        raise ConnectionBrokeError(reason)
    if status not in _ANSWERS:
        raise NotOfferedError(reason)
    Answer(status, body, response.headers).checked()
    raise AssertionError("checked raises an error for these statuses")


def _is_own_problem(body: bytes) -> bool:
    """Tell whether a body is a problem of a Wrongturn service, rather than of a proxy before it."""
    try:
        return Problem.model_validate_json(body).type.rsplit("/", 1)[-1] in set(ProblemType)
    except ValidationError:
        return False
