"""One WebSocket connection to ``/v1/drive``, blocking: frames by the websockets library, bytes by a plain socket.

The library's own blocking client hands each message from one thread to another, which was seen to take longer than
all the rest of a step.
"""

import contextlib
import socket
import ssl
from typing import Final
from urllib.parse import SplitResult

from websockets.client import ClientProtocol
from websockets.datastructures import Headers
from websockets.exceptions import InvalidHandshake, InvalidState, InvalidStatus
from websockets.frames import Frame, Opcode
from websockets.http11 import Response
from websockets.protocol import State
from websockets.typing import Subprotocol
from websockets.uri import parse_uri

from wrongturn_client.connections import Answer, ConnectionBrokeError
from wrongturn_client.errors import NotOfferedError
from wrongturn_client.transport import check
from wrongturn_protocol.wire import PATH, SUBPROTOCOL

_PIECE: Final = 1 << 18
"""Bytes that are asked of the socket at a time."""
_CLOSE_TIMEOUT: Final = 1.0
_ANSWERS: Final = frozenset({401, 429, 502, 503, 504})
"""Refusals of the handshake that say nothing of whether there is such a socket."""


class Link:
    """A connection that is open; :meth:`receive` and :meth:`send` are for one thread."""

    def __init__(self, url: SplitResult, token: str | None, timeout: float) -> None:
        """Connect and shake hands.

        Args:
            url: of the service, ``http`` or ``https``.
            token: the bearer token.
            timeout: seconds for each wait.

        Raises:
            ConnectionBrokeError: nobody is there.
            NotOfferedError: somebody is there, and not this socket.
            ApiError: the service refuses.
        """
        secure = url.scheme == "https"
        self._socket = _connected(url, timeout, secure=secure)
        self._message: list[bytes] = []
        self._events: list[Frame] = []
        target = url._replace(scheme="wss" if secure else "ws", path=url.path + PATH).geturl()
        self._protocol = ClientProtocol(parse_uri(target), subprotocols=[Subprotocol(SUBPROTOCOL)], max_size=None)
        try:
            self._shake_hands(token)
        except BaseException:
            self._socket.close()
            raise

    def send(self, data: bytes) -> None:
        """Send a message. Raises ConnectionBrokeError."""
        try:
            self._protocol.send_binary(data)
            self._flush()
        except (OSError, InvalidState) as error:
            raise ConnectionBrokeError(str(error) or type(error).__name__) from error

    def receive(self) -> bytes:
        """The next message. Raises ConnectionBrokeError."""
        while True:
            while self._events:
                frame = self._events.pop(0)
                if frame.opcode is Opcode.BINARY and frame.fin:
                    return bytes(frame.data)
                if frame.opcode in {Opcode.BINARY, Opcode.TEXT, Opcode.CONT}:
                    self._message.append(bytes(frame.data))
                    if frame.fin:
                        whole, self._message = b"".join(self._message), []
                        return whole
            if self._protocol.state is not State.OPEN:
                raise ConnectionBrokeError(self._why_closed())
            self._read()

    def close(self) -> None:
        """Say goodbye, where there is somebody, and close."""
        with contextlib.suppress(OSError, InvalidState):
            self._socket.settimeout(_CLOSE_TIMEOUT)
            self._protocol.send_close(1000)
            self._flush()
        self._socket.close()

    def _shake_hands(self, token: str | None) -> None:
        request = self._protocol.connect()
        request.headers["User-Agent"] = "wrongturn-client"
        if token:
            request.headers["Authorization"] = f"Bearer {token}"
        self._protocol.send_request(request)
        try:
            self._flush()
            while self._protocol.state is State.CONNECTING and self._protocol.handshake_exc is None:
                self._read()
        except OSError as error:
            raise ConnectionBrokeError(str(error) or type(error).__name__) from error
        failure = self._protocol.handshake_exc
        if isinstance(failure, InvalidStatus):
            _refused(failure.response)
        if isinstance(failure, InvalidHandshake):
            raise NotOfferedError(f"no WebSocket at {PATH}: {failure}") from failure
        if failure is not None:
            raise ConnectionBrokeError(f"the handshake failed: {failure}") from failure
        if self._protocol.subprotocol != SUBPROTOCOL:
            raise NotOfferedError(f"the WebSocket at {PATH} speaks another protocol than {SUBPROTOCOL}")

    def _read(self) -> None:
        """Take what comes next, and answer pings."""
        try:
            data = self._socket.recv(_PIECE)
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


def _refused(response: Response) -> None:
    """Raise what a refused handshake says."""
    headers: Headers = response.headers
    status = response.status_code
    if status not in _ANSWERS:
        raise NotOfferedError(f"no WebSocket of {SUBPROTOCOL} at {PATH}: status {status}")
    media_type = headers.get("content-type", "")
    body = bytes(response.body or b"")
    check(Answer(status, media_type, headers.get("location"), headers.get("retry-after"), body))
