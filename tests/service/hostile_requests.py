"""Requests that are meant to stop a service, each by plain sockets: what they send, and what they are answered."""

import contextlib
import socket
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import repeat

from raw_socket import BINARY, connected, frame, upgrade
from service_harness import Service

KIB = 1024
MIB = 1024 * KIB
_JSON = "Content-Type: application/json\r\n"
_MSGPACK = "Content-Type: application/msgpack\r\n"
_CLOSE = 0x88
_NO_CODE = 1005
_PATIENCE_S = 60.0


@dataclass(frozen=True)
class Target:
    """Whom the requests are sent to, and whose token they have."""

    service: Service
    token: str
    evaluation: str
    """A running evaluation of the token's agent."""


@dataclass(frozen=True)
class Hostile:
    """One request, or one connection full of them.

    Attributes:
        name: What it is.
        send: Sends it; returns the status of the last reply or the code of the close, 0 for neither.
        answers: What it may be answered.
    """

    name: str
    send: Callable[[Target], int]
    answers: frozenset[int]


def _send_all(raw: socket.socket, pieces: Iterable[bytes]) -> None:
    with contextlib.suppress(ConnectionError, TimeoutError):
        for piece in pieces:
            raw.sendall(piece)


def _received(raw: socket.socket, enough: Callable[[bytes], object] = lambda data: False) -> bytes:
    """Return what comes until the service closes, until it is enough, or until nothing comes for a while."""
    data = b""
    with contextlib.suppress(ConnectionError, TimeoutError):
        while not enough(data) and (piece := raw.recv(65536)):
            data += piece
    return data


def _http(head: str, *body: Iterable[bytes]) -> Callable[[Target], int]:
    """Send a head and more on one connection; return the first reply's status."""

    def send(target: Target) -> int:
        with connected(target.service) as raw:
            raw.settimeout(_PATIENCE_S)
            filled = head.replace("{token}", target.token).replace("{evaluation}", target.evaluation)
            _send_all(raw, [filled.encode()])
            for pieces in body:
                _send_all(raw, pieces)
            reply = _received(raw)
        return int(reply.split()[1]) if reply.startswith(b"HTTP/1.1 ") else 0

    return send


def _post(path: str, body: bytes, media: str = _JSON, method: str = "POST") -> Callable[[Target], int]:
    head = (
        f"{method} {path} HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {{token}}\r\n{media}"
        f"Content-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    )
    return _http(head, [body])


def _chunked(*pieces: Iterable[bytes]) -> Callable[[Target], int]:
    head = f"POST /v1/owners HTTP/1.1\r\nHost: x\r\nConnection: close\r\n{_JSON}Transfer-Encoding: chunked\r\n\r\n"
    return _http(head, *pieces)


def _halves(count: int) -> Callable[[Target], int]:
    """Begin many requests, and leave before their bodies are there."""

    def send(target: Target) -> int:
        with contextlib.ExitStack() as stack:
            for _ in range(count):
                raw = stack.enter_context(connected(target.service))
                raw.sendall(f"POST /v1/owners HTTP/1.1\r\nHost: x\r\n{_JSON}Content-Length: 99\r\n\r\n{{".encode())
        return 0

    return send


def _unread(count: int) -> Callable[[Target], int]:
    """Ask on many connections for thirty large documents each, and read none of them."""

    def send(target: Target) -> int:
        with contextlib.ExitStack() as stack:
            for _ in range(count):
                raw = stack.enter_context(connected(target.service, 4096))
                raw.sendall(b"GET /openapi.json HTTP/1.1\r\nHost: x\r\n\r\n" * 30)
        return 0

    return send


def _socket(*pieces: Iterable[bytes]) -> Callable[[Target], int]:
    """Send frames on a connection to the drive; return the code of the service's close."""

    def send(target: Target) -> int:
        with connected(target.service) as raw:
            head = upgrade(raw, target.token)
            assert b" 101 " in head, head
            raw.settimeout(_PATIENCE_S)
            for each in pieces:
                _send_all(raw, each)
            return _close_code(_received(raw, _close_code))

    return send


def _flood(message: bytes, size: int) -> Callable[[Target], int]:
    """Send a message again and again without reading the replies, then close."""
    return _socket(_times(frame(BINARY, message), size), [frame(_CLOSE & 15, b"")])


def _close_code(data: bytes) -> int:
    for kind, begin, end in _frames(data):
        if kind == _CLOSE and end <= len(data):
            return int(struct.unpack("!H", data[begin : begin + 2])[0]) if end > begin else _NO_CODE
    return 0


def _frames(data: bytes) -> Iterator[tuple[int, int, int]]:
    at = 0
    while at + 10 <= len(data) or at + 2 + (data[at + 1 : at + 2] or b"\xff")[0] <= len(data):
        length, begin = data[at + 1] & 127, at + 2
        if length == 126:
            length, begin = struct.unpack_from("!H", data, begin)[0], begin + 2
        elif length == 127:
            length, begin = struct.unpack_from("!Q", data, begin)[0], begin + 8
        yield data[at], begin, begin + length
        at = begin + length


def _errors(size: int) -> bytes:
    """Return a JSON object of so many bytes, each of whose fields is wrong."""
    fields = [b'"%06x":0' % number for number in range(size // 11 - 1)]
    return b"{" + b",".join(fields) + b"}"


def _times(piece: bytes, size: int) -> Iterable[bytes]:
    """Repeat a piece for so many bytes, by 64 KiB at a time."""
    many = piece * max(1, min(65536, size) // len(piece))
    return repeat(many, max(1, size // len(many)))


_BOMB = b"\xdd\x00\x00\x3f\xff" * 1000
"""Arrays in arrays, each of which claims 16,383 items."""
_RECORD = b'{"episode":"ep","steps":-1,"actions_sha256":"","latency_ms":-1}'


def hostile_requests(size: int) -> list[Hostile]:
    """Return all requests.

    Args:
        size: Bytes of those that have no end of their own.
    """
    records = b",".join(repeat(_RECORD, size // len(_RECORD)))
    few = b",".join(repeat(_RECORD, 300))
    open_head = "GET /health/live HTTP/1.1\r\nHost: x\r\n"
    step = "/v1/episodes/ep_none/step"
    results = "/v1/evaluations/{evaluation}/results"
    bearer = "Authorization: Bearer {token}\r\n"

    def part(kind: int) -> bytes:
        return frame(kind, b"", final=False)

    def hostile(name: str, send: Callable[[Target], int], *answers: int) -> Hostile:
        return Hostile(name, send, frozenset(answers))

    return [
        hostile("nothing", lambda target: 0, 0),
        # Bodies
        hostile("registration of 4 MB of errors", _post("/v1/owners", _errors(4 * MIB)), 413),
        hostile("registration of 8 KB of errors", _post("/v1/owners", _errors(8000)), 422),
        hostile("agent of 30 KB of errors", _post("/v1/agents", _errors(30000)), 422),
        hostile("step of 4 MB of errors", _post(step, _errors(4 * MIB)), 413),
        hostile("results of 4 MB of errors", _post(results, b'{"episodes":[' + records + b"]}", method="PUT"), 413),
        hostile("results of 300 wrong records", _post(results, b'{"episodes":[' + few + b"]}", method="PUT"), 422),
        hostile("results of 20 KB of errors", _post(results, _errors(20000), method="PUT"), 422),
        hostile("nested JSON", _post("/v1/owners", b"[" * 8000), 400, 422),
        hostile("a number of 8,000 digits", _post("/v1/owners", b"9" * 8000), 400, 422),
        hostile("msgpack that claims gigabytes", _post(step, _BOMB[:4000], _MSGPACK), 400),
        hostile("msgpack of 4 MB that claims more", _post(step, _BOMB * 800, _MSGPACK), 413),
        hostile("100 bodies that do not come", _halves(100), 0),
        # Heads and framing
        hostile("two hosts", _http("GET /v1/suites HTTP/1.1\r\nHost: x\r\nHost: y\r\n\r\n"), 400),
        hostile("no host", _http("GET /v1/suites HTTP/1.1\r\n\r\n"), 400),
        hostile("a header without end", _http(open_head + "X-A: ", _times(b"a", size)), 431),
        hostile("headers without end", _http(open_head, _times(b"a: b\r\n", size)), 431),
        hostile("an address without end", _http("GET /", _times(b"a", size)), 414, 431),
        hostile("an address of 20 KB", _http(f"GET /{'a' * 20000} HTTP/1.1\r\nHost: x\r\n\r\n"), 414),
        hostile("empty lines without end", _http("", _times(b"\r\n", size)), 400, 431),
        hostile("an extension of a chunk without end", _chunked([b"1;"], _times(b"a", size)), 400, 431),
        hostile("chunks of one byte", _chunked(_times(b"1\r\n{\r\n", size)), 400, 413, 431),
        hostile("a trailer without end", _chunked([b"2\r\n{}\r\n0\r\nX-A: "], _times(b"a", size)), 400, 422, 431),
        hostile("trailers without end", _chunked([b"2\r\n{}\r\n0\r\n"], _times(b"a: b\r\n", size)), 400, 422, 431),
        hostile(
            "requests without waiting", _http("", _times(b"GET /health/live HTTP/1.1\r\nHost: x\r\n\r\n", size)), 0, 200
        ),
        hostile("connections that ask without reading", _unread(max(2, size // 80_000)), 0),
        hostile(
            "a handshake with long headers",
            _http(
                "GET /v1/drive HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                f"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n{bearer}",
                _times(b"X-A: " + b"a" * 4000 + b"\r\n", size),
            ),
            431,
        ),
        # Frames
        hostile("empty parts of a message", _socket([part(BINARY)], _times(part(0), size)), 1009),
        hostile("pings", _socket(_times(frame(9, b""), size)), 1008),
        hostile("pongs", _socket(_times(frame(10, b"none"), size)), 1008),
        hostile("texts", _socket(_times(frame(1, b""), size)), 1003),
        hostile("empty messages", _socket(_times(frame(BINARY, b""), size)), 1007),
        hostile("frames that break the rules", _socket(_times(frame(3, b""), size)), 1002),
        hostile("a message of 8 MB", _socket([frame(BINARY, bytes(8 * MIB))]), 1009),
        hostile("a message that claims gigabytes", _socket([frame(BINARY, _BOMB)]), 1007),
        hostile("a request of errors over the socket", _socket([frame(BINARY, _practise(20000))]), 1007),
        hostile("steps of no episode", _flood(_steps(1), size // 64), 0, 1005),
        hostile("messages of 256 steps of no episode", _flood(_steps(256), size // 64), 0, 1005),
        hostile("messages of 256 aborts of no episode", _flood(_aborts(256), size // 64), 0, 1005),
        hostile("looks at no episode", _flood(b"\x92\x01\x91\x92\xa4look\xa0", size // 64), 0, 1005),
    ]


def _steps(count: int) -> bytes:
    step = b"\x96\xa4step\xa0\x01\x00\x00\x00"
    return b"\x92\x01" + (bytes([0x90 | count]) if count < 16 else b"\xdc" + count.to_bytes(2, "big")) + step * count


def _aborts(count: int) -> bytes:
    return b"\x92\x01\xdc" + count.to_bytes(2, "big") + b"\x92\xa5abort\xa0" * count


def _practise(size: int) -> bytes:
    """Return a message that asks for practice by a map of fields that do not exist."""
    count = size // 8
    fields = b"".join(b"\xa6%06x\x00" % number for number in range(count))
    return b"\x92\x01\x91\x93\xa8practise\xde" + count.to_bytes(2, "big") + fields + b"\xc0"


HEAVY = (
    "/v1/suites",
    "/v1/suites/navigation@1",
    "/v1/suites/navigation@1/trials",
    "/v1/towns",
    "/v1/towns/Town02",
    "/openapi.json",
    "/docs",
    "/v1/agents",
    "/v1/leaderboards/wrong-command@3",
    "/v1/evaluations/{finished}/episodes",
    "/v1/episodes/{episode}/trajectory",
    "/suites/navigation@1",
    "/towns/Town02",
    "/agents",
    "/leaderboards/wrong-command@3",
    "/v1/leaderboards/wrong-command@3/compare?a={one}&b={other}",
    "/leaderboards/wrong-command@3/compare?a={one}&b={other}",
    "/agents/{one}",
    "/episodes/{episode}",
    "/v1/episodes/{episode}/picture.png",
    "/v1/episodes/{episode}/camera/0",
)
"""Public addresses whose replies are large, or take long to make."""
