"""Clients that are too slow, too many, or silent; and a stop while agents drive."""

import asyncio
import contextlib
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import httpx
import pytest
from clocked_service import ClockedService
from drive_socket import DriveSocket
from raw_socket import BINARY, connected, frame, http_problem, press, rest, upgrade
from service_harness import COAST, Agent, await_that, expect, figure, problem
from websockets.exceptions import InvalidStatus

from wrongturn_protocol import wire
from wrongturn_service.storage.models import EpisodeRow
from wrongturn_service.storage.store import Store

PATIENCE_S, PING_INTERVAL_S, PING_TIMEOUT_S = 30.0, 20.0, 60.0
MARGIN_S = 10.0
"""The service's clock also goes by itself; a test may take so long for what it does before a limit."""


@pytest.fixture(scope="module")
def strict(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ClockedService]:
    """A service whose time-outs are the default ones, and which allows few connections to ``/v1/drive``."""
    service = ClockedService(
        tmp_path_factory.mktemp("strict") / "wrongturn.db",
        slow_client_s=PATIENCE_S,
        max_sockets=2,
        max_sockets_per_address=3,
        trusted_proxies="127.0.0.1",
        ping_interval_s=PING_INTERVAL_S,
        ping_timeout_s=PING_TIMEOUT_S,
    )
    yield service
    service.close()


@pytest.fixture(autouse=True)
def _alone(strict: ClockedService) -> None:
    await_that(lambda: strict.connections == 0, "connections of the test before are still there")


def _closed(service: ClockedService, reason: str) -> float:
    return figure(service, f'wrongturn_connections_closed_total{{reason="{reason}"}}')


def _come(raw: socket.socket) -> bytes:
    """What has come by now."""
    raw.setblocking(False)
    try:
        return raw.recv(65536)
    except BlockingIOError:
        return b""
    finally:
        raw.settimeout(120)


@pytest.mark.parametrize("said", [b"", b"GET /v1/suites HTTP/1.1\r\nHost", b"GET /health/live HTTP/1.1\r\nHost: x\r\n"])
def test_a_head_that_does_not_come_to_its_end(strict: ClockedService, said: bytes) -> None:
    before = _closed(strict, "slow-request")
    with connected(strict) as raw:
        raw.sendall(said)
        await_that(lambda: strict.connections == 1, "it is not connected")
        strict.pass_time(PATIENCE_S - MARGIN_S)
        assert _come(raw) == b""
        strict.pass_time(MARGIN_S)
        status, _, told = http_problem(rest(raw))
    assert (status, told["type"]) == (408, "/problems/request-timeout")
    assert _closed(strict, "slow-request") == before + 1


def test_a_head_that_comes_byte_by_byte(strict: ClockedService) -> None:
    with connected(strict) as raw:
        await_that(lambda: strict.connections == 1, "it is not connected")
        for byte in b"GET /health/live HTTP/1.1\r\nHost: x"[: int(PATIENCE_S - MARGIN_S)]:
            raw.send(bytes([byte]))
            strict.pass_time(1)
            assert _come(raw) == b""
        strict.pass_time(MARGIN_S)
        assert http_problem(rest(raw))[0] == 408


def test_a_second_head_that_does_not_come(strict: ClockedService) -> None:
    with connected(strict) as raw:
        raw.sendall(b"GET /health/live HTTP/1.1\r\nHost: x\r\n\r\n")
        assert raw.recv(65536).startswith(b"HTTP/1.1 200")
        strict.pass_time(PATIENCE_S + 1)  # between two requests a client may be silent for longer
        raw.sendall(b"GET /hea")
        strict.pass_time(PATIENCE_S)
        assert http_problem(rest(raw))[0] == 408


def test_a_body_that_does_not_come_to_its_end(strict: ClockedService) -> None:
    with connected(strict) as raw:
        raw.sendall(b"POST /v1/agents HTTP/1.1\r\nHost: x\r\nContent-Length: 100\r\n\r\n{")
        await_that(lambda: strict.connections == 1, "it is not connected")
        strict.pass_time(PATIENCE_S)
        status, _, told = http_problem(rest(raw))
    assert (status, told["type"]) == (408, "/problems/request-timeout")
    assert "body" in told["detail"]


def test_a_message_that_comes_byte_by_byte_though_pings_are_answered(strict: ClockedService) -> None:
    with strict.agent() as agent, connected(strict) as raw:
        assert b" 101 " in upgrade(raw, agent.token)
        reply = b""
        raw.sendall(b"\x02\x81\0\0\0\0x")  # the first fragment, of one byte
        for _ in range(int(PATIENCE_S - MARGIN_S)):
            strict.pass_time(1)
            reply += _come(raw)
            if b"\x89\x04" in reply:  # a ping
                raw.sendall(b"\x8a\x84\0\0\0\0" + reply[reply.index(b"\x89\x04") + 2 :][:4])
                reply = b""
            assert reply == b""
            raw.sendall(b"\0\x81\0\0\0\0x")
        strict.pass_time(MARGIN_S)
        reply = rest(raw)
        at = reply.index(b"request-timeout")
        assert int.from_bytes(reply[at - 2 : at], "big") == 1008


def test_who_never_reads_is_closed_and_its_replies_are_gone(strict: ClockedService) -> None:
    before = _closed(strict, "slow-reader")
    with strict.agent("segmentation") as agent, connected(strict, 65536) as raw:
        episode = agent.practise()["id"]
        expect(agent.step(episode, 1), 200)
        upgrade(raw, agent.token)
        batch = frame(BINARY, wire.pack_calls(1, [["step", episode, 1, 0.0, 0.8, 0.0]] * wire.CALLS))
        # The service reads no further once nothing more of its replies fits between them. If it was only slow, its time
        # begins later.
        left = memoryview(batch * 500)
        for _ in range(2):
            left = press(raw, left, 3)
            assert left
            strict.pass_time(PATIENCE_S)
        await_that(lambda: _closed(strict, "slow-reader") == before + 1, "who never reads stays")
        await_that(lambda: figure(strict, "wrongturn_sockets") == 0, "its connection counts on")
        with contextlib.suppress(TimeoutError, ConnectionError):
            raw.settimeout(120)
            rest(raw)
        expect(agent.step(episode, 2), 200)


@pytest.mark.parametrize("call", [["look"], ["abort"], ["step", 1, 0.0, 0.0, 0.0]])
def test_a_batch_of_look_ups_does_not_keep_out_another_connection(strict: ClockedService, call: list[Any]) -> None:
    begun: list[str] = []
    released = threading.Event()
    found = Store.episode

    async def slow(store: Store, episode: str) -> EpisodeRow | None:
        if episode.startswith("ep_slow"):
            begun.append(episode)
            while not released.is_set():  # noqa: ASYNC110 - the test is in another thread
                await asyncio.sleep(0.001)
        return await found(store, episode)

    name, *rest_of_call = call
    batch = [[name, f"ep_slow{number}", *rest_of_call] for number in range(wire.CALLS)]
    with (
        strict.agent() as one,
        strict.agent() as two,
        patch.object(Store, "episode", slow),
        DriveSocket(strict, one.token) as many,
        DriveSocket(strict, two.token) as other,
    ):
        many.send(*batch)
        await_that(lambda: bool(begun), "nothing is looked up")
        assert other.one("look", "ep_none")[0] == 404
        assert len(begun) == 2
        released.set()
        _, results = many.receive()
        assert {status for status, *_ in results} == {404}
        assert len(begun) == wire.CALLS


def test_who_answers_no_ping_is_gone(strict: ClockedService) -> None:
    with strict.agent() as agent, contextlib.ExitStack() as stack:
        silent = [stack.enter_context(connected(strict)) for _ in range(2)]
        for raw in silent:
            assert b" 101 " in upgrade(raw, agent.token)
        strict.pass_time(PING_INTERVAL_S)
        strict.pass_time(PING_TIMEOUT_S - MARGIN_S)
        assert figure(strict, "wrongturn_sockets") == 2
        strict.pass_time(MARGIN_S)
        await_that(lambda: figure(strict, "wrongturn_sockets") == 0, "half-open connections count on")


def test_so_many_sockets_of_an_agent_and_from_an_address(strict: ClockedService) -> None:
    def refused(token: str) -> None:
        with pytest.raises(InvalidStatus) as caught:
            DriveSocket(strict, token)
        response = caught.value.response
        assert response.status_code == 429
        assert int(response.headers["Retry-After"]) >= 1
        assert response.body is not None
        assert b"/problems/rate-limited" in response.body
        assert b'"position":1' in response.body

    with strict.agent() as one, strict.agent() as two:
        with DriveSocket(strict, one.token) as first, DriveSocket(strict, one.token):
            refused(one.token)
            with DriveSocket(strict, two.token), connected(strict) as proxied:
                refused(two.token)
                # A proxy on this machine speaks for an address of its own.
                assert b" 101 " in upgrade(proxied, two.token, X_Forwarded_For="192.0.2.7")
            assert first.one("look", "ep_none")[0] == 404
        await_that(lambda: figure(strict, "wrongturn_sockets") == 0, "closed connections count on")
        DriveSocket(strict, one.token).socket.close()


def test_the_line_over_the_socket(strict: ClockedService) -> None:
    wanted = {"town": "Town01", "approach": "J3-S", "seed": 3}
    with strict.agent() as agent, strict.agent() as other, DriveSocket(strict, agent.token) as drive:
        held = [drive.one("practise", wanted, None)[1]["id"] for _ in range(2)]
        with DriveSocket(strict, other.token) as late:
            for _ in range(2):
                status, told = late.one("practise", wanted, "a key")
                assert (status, told["type"], told["position"]) == (503, "/problems/simulators-busy", 1)
                assert told["retry_after_s"] == 1
            assert drive.one("practise", wanted, "another")[1]["position"] == 2
            drive.one("abort", held[0])
            assert drive.one("practise", wanted, "another")[1]["position"] == 1
            assert late.one("practise", wanted, "a key")[0] == 201
        drive.one("abort", held[1])


def test_too_many_connections(tmp_path: Path) -> None:
    service = ClockedService(tmp_path / "wrongturn.db", max_connections=3)
    with contextlib.ExitStack() as stack:
        stack.callback(service.close)
        with httpx.Client(base_url=service.url, timeout=60) as http:
            expect(http.get("/health/live"), 200)
            others = [stack.enter_context(connected(service)) for _ in range(2)]
            await_that(lambda: service.connections == 3, "they are not connected")
            for _ in range(2):
                with connected(service) as late:
                    status, headers, told = http_problem(rest(late))
                assert (status, told["type"]) == (503, "/problems/service-full")
                assert int(headers["retry-after"]) >= 1
            said = [log["reason"] for log in service.logs if log["event"] == "connection closed"]
            assert said == ["too-many"], "one line for all of them"
            others[0].close()
            await_that(lambda: _answers(service), "a place that is free again is not given")
            assert _closed(service, "too-many") >= 2


def _answers(service: ClockedService) -> bool:
    try:
        return httpx.get(service.url + "/health/live", timeout=60).status_code == 200
    except httpx.RemoteProtocolError:
        return False


def test_a_stop_lets_agents_come_to_their_end_and_begins_nothing(tmp_path: Path) -> None:
    service = ClockedService(tmp_path / "wrongturn.db", shutdown_grace_s=600)
    with service.agent() as agent, DriveSocket(service, agent.token) as drive:
        evaluation = agent.evaluate()["id"]
        episode = expect(agent.reset(evaluation), 201)["id"]
        idle = agent.practise()["id"]
        service.pass_time(2)  # the stop waits for no agent that is silent
        expect(agent.step(episode, 1, COAST), 200)
        service.signal()
        _stopping(agent)
        refused = agent.reset(evaluation)
        problem(refused, 503, "shutting-down")
        assert int(refused.headers["Retry-After"]) >= 1
        result = drive.one("next", evaluation, None)
        assert (result[0], result[1]["type"], result[1]["retry_after_s"]) == (503, "/problems/shutting-down", 5)
        seq, over = 1, False
        while not over:
            assert service.running
            seq += 1
            if seq % 2:
                last = expect(agent.step(episode, seq, COAST), 200)
            else:
                status, last, _ = drive.one("step", episode, seq, *COAST.values())
                assert status == 200, last
            over = last["terminated"] or last["truncated"]
        service.join()
    service.close()
    assert [log["count"] for log in service.logs if log["event"].startswith("episodes are lost by the stop")] == [1]
    again = ClockedService(tmp_path / "wrongturn.db")
    try:
        headers = {"Authorization": f"Bearer {agent.token}"}
        with httpx.Client(base_url=again.url, headers=headers, timeout=60) as http:
            assert expect(http.get(f"/v1/evaluations/{evaluation}"), 200)["finished"] == 1
            repeated = http.post(f"/v1/episodes/{episode}/step", json={"seq": seq, "action": COAST})
            assert expect(repeated, 200)["seq"] == seq
            lost = http.post(f"/v1/episodes/{idle}/step", json={"seq": 1, "action": COAST})
            problem(lost, 410, "episode-lost")
    finally:
        again.close()


def _stopping(agent: Agent) -> None:
    await_that(lambda: agent.http.get("/health/ready").status_code == 503, "it is ready though it stops")


def test_a_second_signal_does_not_wait(tmp_path: Path) -> None:
    service = ClockedService(tmp_path / "wrongturn.db", shutdown_grace_s=600)
    try:
        with service.agent() as agent:
            episode = agent.practise()["id"]
            service.signal()
            _stopping(agent)
            for seq in range(1, 5):
                expect(agent.step(episode, seq, COAST), 200)
            assert service.running
            service.signal()
            service.join()
    finally:
        service.close()
