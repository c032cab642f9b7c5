"""Clients that misbehave on purpose: plain sockets, so that nothing is answered that the test does not answer."""

import contextlib
import json
import socket
import struct
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

from service_harness import Service

from wrongturn_protocol import wire

BINARY = 0x2


@contextlib.contextmanager
def connected(service: Service, receive_buffer: int | None = None) -> Iterator[socket.socket]:
    """A TCP connection to the service."""
    raw = dial(service, receive_buffer)
    try:
        yield raw
    finally:
        raw.close()


def dial(service: Service, receive_buffer: int | None = None) -> socket.socket:
    parts = urlsplit(service.url)
    raw = socket.socket()
    if receive_buffer is not None:
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
    raw.settimeout(120)
    raw.connect((parts.hostname, parts.port))
    return raw


def upgrade(raw: socket.socket, token: str, **headers: str) -> bytes:
    """Shake hands for the drive; the reply's head."""
    extra = "".join(f"{name.replace('_', '-')}: {value}\r\n" for name, value in headers.items())
    raw.sendall(
        f"GET {wire.PATH} HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
        f"Sec-WebSocket-Protocol: {wire.SUBPROTOCOL}\r\nAuthorization: Bearer {token}\r\n{extra}\r\n".encode()
    )
    head = b""
    while b"\r\n\r\n" not in head:
        piece = raw.recv(1)
        assert piece, head
        head += piece
    return head


def frame(kind: int, payload: bytes, *, final: bool = True, mask: bytes = b"\x01\x02\x03\x04") -> bytes:
    """One frame of a client's."""
    size = len(payload)
    first = kind | (0x80 if final else 0)
    if size < 126:
        head = bytes([first, 0x80 | size])
    elif size < 65536:
        head = struct.pack("!BBH", first, 0xFE, size)
    else:
        head = struct.pack("!BBQ", first, 0xFF, size)
    repeated = int.from_bytes((mask * (size // 4 + 1))[:size], "big")
    return head + mask + (int.from_bytes(payload, "big") ^ repeated).to_bytes(size, "big")


def press(raw: socket.socket, data: memoryview, patience_s: float) -> memoryview:
    """Send until nothing is taken for so long, or the other side closes; what is left."""
    raw.settimeout(patience_s)
    with contextlib.suppress(TimeoutError, ConnectionError):
        while data:
            data = data[raw.send(data) :]
    return data


def rest(raw: socket.socket) -> bytes:
    """All that comes until the other side closes."""
    data = b""
    with contextlib.suppress(ConnectionResetError):
        while piece := raw.recv(65536):
            data += piece
    return data


def http_problem(reply: bytes) -> tuple[int, dict[str, str], dict[str, Any]]:
    """Status, headers and body of a refusal as it came."""
    head, _, body = reply.partition(b"\r\n\r\n")
    first, *lines = head.decode().split("\r\n")
    headers = {name.lower(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    assert headers["content-type"] == "application/problem+json", reply
    return int(first.split()[1]), headers, json.loads(body)
