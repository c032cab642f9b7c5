"""Uploads over real connections: clients that are refused, slow, gone, or send another length than they said."""

import contextlib
import json
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from model_form import TYPE, model, part
from raw_socket import connected, http_problem, rest
from service_harness import expect, problem
from submission_owner import until
from submission_story import OPERATOR, TakingService

LIMIT = 32 * 1024 * 1024
PATIENCE_S = 30.0
MUCH = b"m" * (1 << 20)


class Taking(TakingService):
    """A service with an owner."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, model_limit=LIMIT, slow_client_s=PATIENCE_S, submissions_per_owner=64)
        self.folder = folder / "submissions"
        self.token = self.owner("ada")

    def head(self, length: int | None, token: str = "", **headers: str) -> bytes:
        """The head of a request that hands a model in; without a length the body comes in chunks."""
        named = {
            "Host": "x",
            "Authorization": f"Bearer {token or self.token}",
            "Content-Type": TYPE,
            "Transfer-Encoding" if length is None else "Content-Length": "chunked" if length is None else str(length),
            **{name.replace("_", "-"): value for name, value in headers.items()},
        }
        lines = "".join(f"{name}: {value}\r\n" for name, value in named.items())
        return f"POST /v1/submissions HTTP/1.1\r\n{lines}\r\n".encode()

    @property
    def files(self) -> list[str]:
        return sorted(file.name for file in self.folder.iterdir())


@pytest.fixture(scope="module")
def taking(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Taking]:
    service = Taking(tmp_path_factory.mktemp("taking"))
    yield service
    service.close()


@pytest.fixture(autouse=True)
def _nothing_left(taking: Taking) -> Iterator[None]:
    """Each test leaves as many files as there are submissions that wait, and no connections and requests."""
    yield
    until(lambda: taking.at_rest)

    def known() -> set[str]:
        headers = {"Authorization": f"Bearer {OPERATOR}"}
        rows = expect(httpx.get(f"{taking.url}/v1/submissions", headers=headers, timeout=60), 200)["submissions"]
        return {f"{row['id']}.onnx" for row in rows if row["state"] not in {"failed", "cancelled"}}

    until(lambda: set(taking.files) == known())


def reply(raw: socket.socket) -> tuple[int, dict[str, Any]]:
    """Status and body of a reply with a length."""
    data = b""
    while b"\r\n\r\n" not in data:
        piece = raw.recv(65536)
        assert piece, data
        data += piece
    head, _, body = data.partition(b"\r\n\r\n")
    length = next(
        int(line.split(b":")[1]) for line in head.split(b"\r\n") if line.lower().startswith(b"content-length")
    )
    while len(body) < length:
        body += raw.recv(65536)
    return int(head.split()[1]), json.loads(body)


def named(name: str, value: bytes = b"a model") -> bytes:
    return model(value, name)


REFUSED: list[tuple[dict[str, Any], int]] = [
    ({"token": "nobodys"}, 401),
    ({"token": OPERATOR}, 403),
    ({"length": 1 << 40}, 413),
    ({"length": None, "token": "nobodys"}, 401),
    ({"Content_Type": "application/octet-stream"}, 415),
    ({"Content_Type": "multipart/form-data"}, 400),
]


@pytest.mark.parametrize(("said", "status"), REFUSED)
def test_a_refused_body_is_not_read(taking: Taking, said: dict[str, Any], status: int) -> None:
    """The reply comes before the body, and the service takes no more of it than its buffers hold."""
    with connected(taking) as raw:  # one that waits for 100 sends nothing in vain
        raw.sendall(taking.head(**{"length": 1 << 24, **said}, Expect="100-continue"))
        assert http_problem(rest(raw))[0] == status
    with connected(taking) as raw:
        raw.sendall(taking.head(**{"length": 1 << 24, **said}))
        until(lambda: bool(peeked(raw)))
        sent = 0
        with contextlib.suppress(ConnectionError, TimeoutError):
            raw.settimeout(5)
            while sent < 1 << 28:
                sent += raw.send(MUCH)
        # What lies in the buffers of this end is counted too.
        assert sent < 1 << 24, sent
        found, headers, _ = http_problem(rest(raw))
    assert found == status
    assert headers["connection"] == "close"


def peeked(raw: socket.socket) -> bytes:
    raw.setblocking(False)
    try:
        return raw.recv(1, socket.MSG_PEEK)
    except BlockingIOError:
        return b""
    finally:
        raw.settimeout(60)


@pytest.mark.parametrize(
    ("name", "suite", "status"), [("theirs", "smoke@3", 409), ("mine", "none@1", 404), ("?", "smoke@3", 422)]
)
def test_a_name_or_suite_that_is_refused_costs_no_upload(taking: Taking, name: str, suite: str, status: int) -> None:
    theirs = {"Authorization": f"Bearer {taking.owner(f'owner {status}')}", "Content-Type": TYPE}
    httpx.post(f"{taking.url}/v1/submissions", content=named("theirs"), headers=theirs, timeout=60)
    body = model(MUCH * 24, name, suite)
    with connected(taking) as raw:
        raw.sendall(taking.head(len(body)) + body[: 2 << 20])
        until(lambda: bool(peeked(raw)))
        assert http_problem(rest(raw))[0] == status
    # A client that sends on meets the end of the connection, and finds the reply.
    with httpx.Client(base_url=taking.url, headers={"Authorization": f"Bearer {taking.token}"}, timeout=60) as http:
        reply = http.post(
            "/v1/submissions", data={"suite": suite, "name": name}, files={"model": ("a.onnx", MUCH * 24)}
        )
    assert reply.status_code == status


def test_who_waits_for_100_gets_it(taking: Taking) -> None:
    body = named("waits for 100")
    with connected(taking) as raw:
        raw.sendall(taking.head(len(body), Expect="100-continue"))
        assert raw.recv(65536) == b"HTTP/1.1 100 Continue\r\n\r\n"
        raw.sendall(body)
        assert reply(raw)[0] == 202


def test_a_large_model_in_any_pieces(taking: Taking) -> None:
    large = bytes(range(256)) * (LIMIT // 256)
    body = named("large", large)
    with connected(taking) as raw:
        raw.sendall(taking.head(len(body)))
        for at in range(0, len(body), 100_003):
            raw.sendall(body[at : at + 100_003])
        status, told = reply(raw)
        assert status == 202
        assert told["size"] == LIMIT
        assert (taking.folder / f"{told['id']}.onnx").read_bytes() == large
        # The connection goes on.
        again = named("small")
        raw.sendall(taking.head(len(again)) + again)
        assert reply(raw)[0] == 202


def test_a_body_in_chunks(taking: Taking) -> None:
    body = named("in chunks")
    with connected(taking) as raw:
        raw.sendall(taking.head(None))
        for byte in body:
            raw.sendall(b"1\r\n" + bytes([byte]) + b"\r\n")
        raw.sendall(b"0\r\n\r\n")
        assert reply(raw)[0] == 202


def test_chunks_without_end_are_refused_at_the_limit(taking: Taking) -> None:
    begin = part("suite", b"smoke@3") + part("name", b"endless") + part("model", MUCH)[:-2]
    sent = 0
    with connected(taking) as raw:
        raw.sendall(taking.head(None) + f"{len(begin):x}\r\n".encode() + begin + b"\r\n")
        with contextlib.suppress(ConnectionError):
            while sent < 2 * LIMIT:
                raw.sendall(f"{len(MUCH):x}\r\n".encode() + MUCH + b"\r\n")
                sent += len(MUCH)
                if peeked(raw):
                    break
        found, headers, told = http_problem(rest(raw))
    assert (found, told["type"], headers["connection"]) == (413, "/problems/body-too-large", "close")
    assert sent < LIMIT + (1 << 24)


def test_a_body_that_is_shorter_than_said(taking: Taking) -> None:
    body = named("shorter")
    with connected(taking) as raw:
        raw.sendall(taking.head(len(body) + 100) + body)
        until(lambda: taking.connections == 1)
        raw.shutdown(socket.SHUT_WR)
        rest(raw)


def test_a_client_that_leaves(taking: Taking) -> None:
    body = named("leaves", MUCH * 8)
    for sent in (0, 10, 300, 2 << 20, len(body) - 1):
        with connected(taking) as raw:
            raw.sendall(taking.head(len(body)) + body[:sent])
            until(lambda: taking.connections == 1)
        until(lambda: taking.at_rest)


@pytest.mark.parametrize("sent", [0, 100, (1 << 20) + 1000])
def test_a_client_that_is_too_slow(taking: Taking, sent: int) -> None:
    body = named("slow", MUCH * 2)
    with connected(taking) as raw:
        raw.sendall(taking.head(len(body)) + body[:sent])
        until(lambda: bool([name for name in taking.files if name.endswith(".part")]))
        deadline = time.monotonic() + 60
        while not peeked(raw):
            assert time.monotonic() < deadline
            taking.pass_time(PATIENCE_S / 3)
        found, headers, told = http_problem(rest(raw))
    assert (found, told["type"]) == (408, "/problems/request-timeout")
    assert headers["connection"] == "close"


def test_a_client_that_is_slow_enough(taking: Taking) -> None:
    """64 KiB within the time is enough, however long the whole takes."""
    body = named("slow enough", MUCH)
    with connected(taking) as raw:
        raw.sendall(taking.head(len(body)))
        until(lambda: bool([name for name in taking.files if name.endswith(".part")]))
        for at in range(0, len(body), 70_000):
            raw.sendall(body[at : at + 70_000])
            time.sleep(0.05)
            taking.pass_time(PATIENCE_S - 5)
        assert reply(raw)[0] == 202


def test_so_many_uploads_of_an_owner_at_a_time(taking: Taking) -> None:
    """Uploads under way count, or connections that stay open would fill the disk."""
    begin = named("many", MUCH)[:1000]
    token = taking.owner("many")
    most = 64
    with contextlib.ExitStack() as stack:
        raws = [stack.enter_context(connected(taking)) for _ in range(most)]
        for raw in raws:
            raw.sendall(taking.head(1 << 20, token) + begin)
        until(lambda: len([name for name in taking.files if name.endswith(".part")]) == most)
        headers = {"Authorization": f"Bearer {token}", "Content-Type": TYPE}
        refused = httpx.post(f"{taking.url}/v1/submissions", content=named("more"), headers=headers, timeout=60)
        assert problem(refused, 429, "rate-limited")["position"] == 1
        body = named("others may")
        headers["Authorization"] = f"Bearer {taking.token}"
        expect(httpx.post(f"{taking.url}/v1/submissions", content=body, headers=headers, timeout=60), 202)
    until(lambda: taking.at_rest)
    headers["Authorization"] = f"Bearer {token}"
    expect(httpx.post(f"{taking.url}/v1/submissions", content=named("after"), headers=headers, timeout=60), 202)


def test_a_stop_during_uploads(tmp_path: Path) -> None:
    service = Taking(tmp_path)
    body = named("stopped", MUCH * 3)
    try:
        with connected(service) as early, connected(service) as late:
            early.sendall(service.head(len(body)))
            late.sendall(service.head(len(body)) + body[: 2 << 20])
            until(lambda: len(service.files) == 2)
            service.signal()
            service.signal()
            service.join()
    finally:
        service.close()
    assert service.files == []
    assert not [line for line in service.logs if line["log_level"] == "error"]
