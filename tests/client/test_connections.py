"""Plain HTTP over real sockets: kept open, not trusted for ever, and honest when they break."""

import math
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from wrongturn_client import Client, ServiceUnreachableError, transport
from wrongturn_client.transport import HttpxConnections, PlainConnections, Transport, _split, connect


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        self.server.peers.append(self.client_address[1])  # type: ignore[attr-defined]
        self.server.headers_seen.append(dict(self.headers))  # type: ignore[attr-defined]
        body = b'{"suites": []}'
        self.send_response(200)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *args: Any) -> None:
        pass


class Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.peers: list[int] = []
        self.headers_seen: list[dict[str, str]] = []

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server()
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


@contextmanager
def _raw(answers: list[bytes]) -> Iterator[str]:
    """A server that gives each connection one of these and hangs up."""
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(120)

    def serve() -> None:
        for answer in answers:
            connection, _ = listener.accept()
            with connection:
                connection.recv(65536)
                connection.sendall(answer)

    thread = threading.Thread(target=serve)
    thread.start()
    yield f"http://127.0.0.1:{listener.getsockname()[1]}"
    thread.join()
    listener.close()


def test_calls_share_a_connection_and_say_who_calls(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transport, "_IDLE", math.inf)
    with Client(server.url, "secret") as client:
        for _ in range(5):
            client.suites()
    assert len(set(server.peers)) == 1
    assert server.headers_seen[0]["Authorization"] == "Bearer secret"
    assert server.headers_seen[0]["User-Agent"] == "wrongturn-client"


def test_a_connection_that_was_idle_is_not_trusted(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transport, "_IDLE", 0.0)
    with Client(server.url) as client:
        client.suites()
        client.suites()
    assert len(set(server.peers)) == 2


def test_threads_may_share_a_client(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transport, "_IDLE", math.inf)
    with Client(server.url) as client:
        threads = [threading.Thread(target=lambda: [client.suites() for _ in range(20)]) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(server.peers) == 80
    assert len(set(server.peers)) <= 4


OK = b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: 14\r\n\r\n" + b'{"suites": []}'


@pytest.mark.parametrize("broken", [b"", OK[:-5], OK[:20], b"nonsense\r\n\r\n"])
def test_a_broken_answer_is_asked_for_again(broken: bytes) -> None:
    with _raw([broken, OK]) as url, Client(url) as client:
        assert client.suites() == ()


def test_a_closed_connection_is_opened_again() -> None:
    with _raw([OK, OK]) as url, Client(url) as client:
        client.suites()
        client.suites()


def test_a_silent_service_is_given_up() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        url = f"http://127.0.0.1:{listener.getsockname()[1]}"
        with Client(url, patience=0, timeout=0.05) as client, pytest.raises(ServiceUnreachableError, match="timed out"):
            client.suites()


def test_tls_and_proxies_go_by_httpx(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("http_proxy", "HTTP_PROXY", "no_proxy", "NO_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    assert isinstance(connect(_split("http://there"), 1), PlainConnections)
    assert isinstance(connect(_split("https://there"), 1), HttpxConnections)
    monkeypatch.setenv("http_proxy", "http://proxy:1")
    assert isinstance(connect(_split("http://there"), 1), HttpxConnections)
    monkeypatch.setenv("no_proxy", "there")
    assert isinstance(connect(_split("http://there"), 1), PlainConnections)
    Transport("http://there", None).close()
