"""How loans end by what their client, the operator, or a signal does; what was begun is not lost by it."""

import contextlib
import os
import signal
import socket
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from random import Random
from urllib.parse import urlsplit

import pytest
from lent_socket import LOOK, LentSocket, borrowers, figure, lent, until
from loan_story import TRIAL, Payloads, action, begin, fields, go_on, over, stored
from service_harness import Agent, RunningService, expect
from test_drive_frames import BINARY, CLOSE, LIMIT, PING, TEXT, frame

from wrongturn_client.drive import Drive
from wrongturn_protocol import Action, Track, wire
from wrongturn_service.episodes.lease import Lease, Standing, Terms

# What ends the connection

ENDINGS = {
    "text": (frame(TEXT, b"hello"), 1003, "text-message"),
    "text in fragments": (frame(TEXT, b"te", final=False) + frame(0, b"xt"), 1003, "text-message"),
    "truncated": (frame(BINARY, b"\x92\x01"), 1007, "truncated-message"),
    "nothing at all": (frame(BINARY, b""), 1007, "truncated-message"),
    "no msgpack": (frame(BINARY, b"\xc1"), 1007, "malformed-message"),
    "no call": (frame(BINARY, b"\x92\x01\x90"), 1007, "malformed-message"),
    "too large": (frame(BINARY, bytes(LIMIT + 1)), 1009, "message-too-large"),
    "far too large": (b"\x82\xff" + (3 * LIMIT).to_bytes(8, "big") + b"\x01\x02\x03\x04", 1009, ""),
    "without a mask": (b"\x82\x03\x92\x01\x90", 1002, ""),
    "a reserved bit": (frame(BINARY | 0x40, b"\x92\x01\x90"), 1002, ""),
    "a close": (frame(CLOSE, (1000).to_bytes(2, "big")), 1000, ""),
    "a close without a code": (frame(CLOSE, b""), 1005, ""),
}


@pytest.mark.parametrize("name", ENDINGS)
def test_what_ends_the_connection(
    service: RunningService, agent: Agent, drive: LentSocket, reference: Payloads, name: str
) -> None:
    data, code, kind = ENDINGS[name]
    episode = agent.practise(**TRIAL)["id"]
    seq = begin(drive, episode, reference)
    drive.raw.sendall(data)
    if kind:
        number, ((_, told),) = wire.unpack_results(drive.receive())
        assert (number, told["type"]) == (None, f"/problems/{kind}")
    last, reason = drive.frame()
    assert (last, reason[:2]) == (CLOSE, b"" if code == 1005 else code.to_bytes(2, "big"))
    if kind:
        assert reason[2:].decode() == kind
    with LentSocket(service, agent.token) as again:
        go_on(again, episode, reference, seq)


@pytest.mark.parametrize("reset", [False, True])
@pytest.mark.parametrize("asked", [False, True])
def test_a_connection_that_is_dropped(
    service: RunningService, agent: Agent, drive: LentSocket, reference: Payloads, reset: bool, asked: bool
) -> None:
    episode = agent.practise(**TRIAL)["id"]
    seq = begin(drive, episode, reference)
    if asked:
        drive.send(["step", episode, seq + 1, *action(seq + 1)])
    if reset:
        drive.raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    os.close(drive.raw.detach())
    until(lambda: not lent(service) and not figure(service, "wrongturn_sockets"), "it counts on")
    with LentSocket(service, agent.token) as again:
        assert again.step(episode, seq + 1, action(seq + 1)) == reference[seq + 1]
        go_on(again, episode, reference, seq + 1)


def test_an_episode_that_is_deleted(agent: Agent, drive: LentSocket, reference: Payloads) -> None:
    episode = agent.practise(**TRIAL)["id"]
    seq = begin(drive, episode, reference)
    assert agent.http.delete(f"/v1/episodes/{episode}").status_code == 204
    status, told = drive.call("step", episode, seq + 1, *action(seq + 1))
    assert (status, told["type"]) == (409, "/problems/episode-finished")
    assert stored(drive.service, episode)[1:4:2] == ("aborted", seq)


def test_an_evaluation_that_is_cancelled(service: RunningService, agent: Agent, drive: LentSocket) -> None:
    evaluation = agent.evaluate()["id"]
    episode = expect(agent.reset(evaluation), 201)["id"]
    seq = 0
    while not lent(service):
        seq += 1
        assert not over(drive.step(episode, seq, action(seq)))
    expect(agent.http.delete(f"/v1/evaluations/{evaluation}"), 200)
    status, told = drive.call("step", episode, seq + 1, *action(seq + 1))
    assert (status, told["type"]) == (409, "/problems/evaluation-cancelled")
    assert drive.call(*LOOK)[0] == 404


@pytest.mark.parametrize("revoked", [False, True])
def test_a_token_that_is_good_no_more(service: RunningService, reference: Payloads, revoked: bool) -> None:
    with service.agent() as agent, LentSocket(service, agent.token) as drive:
        episode = agent.practise(**TRIAL)["id"]
        seq = begin(drive, episode, reference)
        if revoked:
            assert agent.http.delete(f"/v1/agents/{agent.id}/token").status_code == 204
        else:
            renewed = expect(agent.http.post(f"/v1/agents/{agent.id}/token"), 201)
        drive.send(["step", episode, seq + 1, *action(seq + 1)])
        number, ((status, told),) = wire.unpack_results(drive.receive())
        assert (number, status, told["type"]) == (None, 401, "/problems/unauthenticated")
        assert drive.frame() == (CLOSE, (1008).to_bytes(2, "big") + b"unauthenticated")
        if not revoked:
            with Agent(service.url, renewed) as back, LentSocket(service, back.token) as again:
                go_on(again, episode, reference, seq)


# What dies, and what does not answer


@pytest.fixture(scope="module")
def fragile(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    """A service of little patience, whose simulators may be killed."""
    running = RunningService(
        tmp_path_factory.mktemp("fragile") / "wrongturn.db",
        simulators=2,
        spare_simulators=1,
        simulator_timeout_s=1.5,
        slow_client_s=1.5,
        lease_release_s=3,
        ping_interval_s=0.4,
        ping_timeout_s=2,
        registration_limit=1000,
    )
    assert running.ready, running.stderr
    yield running
    assert running.stop() == 0, running.stderr
    # That a simulator was killed while it started is an error, too, and none of the service's.
    assert "internal error" not in running.stderr, running.stderr


def _client_drive(service: RunningService, agent: Agent) -> Drive:
    return Drive(urlsplit(service.url), agent.token, timeout=30, patience=120)


def _signalled(service: RunningService, reference: Payloads, number: int, times: int) -> None:
    """Drive by the client while a thread sends a signal to whichever simulator has the connection, at any moment."""
    sent: list[int] = []
    stop = threading.Event()
    dice = Random(times)

    def disturb() -> None:
        while not stop.is_set() and len(sent) < times:
            time.sleep(0.02 + dice.random() * 0.08)
            for pid in set(borrowers(service)) - set(sent):
                time.sleep(dice.random() * 0.004)
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, number)
                    sent.append(pid)

    thread = threading.Thread(target=disturb)
    thread.start()
    try:
        with service.agent() as agent:
            while len(sent) < times:
                episode = agent.practise(**TRIAL)["id"]
                _drive_by_client(service, agent, episode, reference)
                assert stored(service, episode)[3] == len(reference) - 1
    finally:
        stop.set()
        thread.join()


def _drive_by_client(service: RunningService, agent: Agent, episode: str, reference: Payloads) -> None:
    with Drive(urlsplit(service.url), agent.token, timeout=30, patience=120) as client:
        for seq in range(1, len(reference)):
            time.sleep(0.001)  # so that there is a moment between two steps, too
            reply = client.step(episode, seq, Action.model_validate(fields(seq)))
            _, ((_, told, block),) = wire.unpack_results(reference[seq])
            shown = reply.model_dump(exclude_none=True)
            assert wire.block(shown.pop("observation"), Track.PRIVILEGED) == block, seq
            assert shown == told


@pytest.mark.parametrize(
    ("number", "times"),
    [
        (signal.SIGKILL, 2),
        (signal.SIGSTOP, 1),
        pytest.param(signal.SIGKILL, 60, marks=pytest.mark.soak),
        pytest.param(signal.SIGSTOP, 20, marks=pytest.mark.soak),
    ],
)
def test_a_simulator_that_dies_or_hangs_at_any_moment(
    fragile: RunningService, reference: Payloads, number: int, times: int
) -> None:
    deaths = figure(fragile, "wrongturn_simulator_deaths_total")
    _signalled(fragile, reference, number, times)
    assert figure(fragile, "wrongturn_simulator_deaths_total") > deaths


def test_who_does_not_read_is_closed_and_goes_on_over_http(fragile: RunningService) -> None:
    closed = 'wrongturn_connections_closed_total{reason="slow-reader"}'
    before = figure(fragile, closed)
    with fragile.agent() as agent, LentSocket(fragile, agent.token, receive_buffer=65536) as drive:
        episode = agent.practise(**TRIAL | {"track": "segmentation"})["id"]
        seq = 0
        while not lent(fragile):
            seq += 1
            drive.step(episode, seq, action(seq))
        steps = [["step", episode, min(at, seq + 9), *action(min(at, seq + 9))] for at in range(seq + 1, seq + 500)]
        drive.raw.settimeout(5)
        with contextlib.suppress(TimeoutError, ConnectionError):
            for at, step in enumerate(steps):
                drive.send(step, number=at)
        until(lambda: figure(fragile, closed) == before + 1, "who never reads stays")
        until(lambda: not figure(fragile, "wrongturn_sockets") and not lent(fragile), "it counts on")
        taken = expect(agent.http.get(f"/v1/episodes/{episode}"), 200)["seq"]
        assert seq < taken <= seq + 9
        assert expect(agent.step(episode, taken + 1, fields(taken + 1)), 200)["seq"] == taken + 1


def test_who_answers_no_ping_is_closed_between_two_replies(fragile: RunningService, reference: Payloads) -> None:
    with fragile.agent() as agent, LentSocket(fragile, agent.token) as drive:
        episode = agent.practise(**TRIAL)["id"]
        seq = begin(drive, episode, reference)
        assert drive.frame()[0] == PING  # since it is silent; it is never answered
        while seq + 1 < len(reference):
            seq += 1
            drive.send(["step", episode, seq, *action(seq)], number=seq)
            while (came := drive.frame())[0] == PING:
                pass
            if came[0] == CLOSE:
                break
            assert came == (BINARY, reference[seq])
            time.sleep(0.06)  # so that the time of the answer comes in the middle of the drive
        assert came == (CLOSE, (1011).to_bytes(2, "big") + b"keepalive ping timeout")


def test_a_simulator_is_released_when_its_agent_falls_silent_in_a_loan(
    fragile: RunningService, reference: Payloads
) -> None:
    with fragile.agent() as agent, LentSocket(fragile, agent.token) as drive:
        episode = agent.practise(**TRIAL)["id"]
        seq = begin(drive, episode, reference)
        silent_since = time.monotonic()
        until(lambda: not lent(fragile), "silence does not end a loan")
        until(lambda: figure(fragile, "wrongturn_leases_released") == 1, "its simulator is kept")
        assert time.monotonic() - silent_since > 2.5
        with LentSocket(fragile, agent.token) as back:
            assert back.step(episode, seq + 1, action(seq + 1)) == reference[seq + 1]


def test_what_was_heard_before_does_not_shorten_a_lease() -> None:
    now = 100.0
    lease = Lease(Terms(release_s=2, abort_s=10), lambda: now)
    now = 103.0
    lease.renew(1.0)
    assert lease.silence_s == 1.0
    lease.renew()
    lease.renew(1.5)  # a loan's end tells of a message, but a call came after it
    assert lease.silence_s == 0.0
    now = 105.5
    assert lease.standing is Standing.RELEASE


def test_loans_leave_no_handle_behind(service: RunningService, agent: Agent, reference: Payloads) -> None:
    def handles() -> dict[int, int]:
        return {pid: len(list(Path(f"/proc/{pid}/fd").iterdir())) for pid in (service.process.pid, *pids)}

    def drive_all() -> None:
        with LentSocket(service, agent.token) as drive:
            episode = agent.practise(**TRIAL)["id"]
            go_on(drive, episode, reference, 0)
        until(lambda: not figure(service, "wrongturn_sockets"), "a closed connection counts on")

    drive_all()
    pids = service.simulators()
    before = handles()
    for _ in range(-(-1000 // len(reference))):
        drive_all()
    until(lambda: handles() == before, f"{before} became {handles()}")


def test_a_stop_in_a_loan(tmp_path: Path, reference: Payloads) -> None:
    own = RunningService(tmp_path / "wrongturn.db", simulators=2, shutdown_grace_s=60)
    try:
        with (
            own.agent() as agent,
            own.agent() as idle,
            LentSocket(own, agent.token) as drive,
            LentSocket(own, idle.token) as silent,
        ):
            waits = idle.practise(**TRIAL)["id"]
            for seq in range(1, 5):
                assert silent.step(waits, seq, action(seq)) == reference[seq]
            episode = agent.practise(**TRIAL)["id"]
            for seq in range(1, 10):
                assert drive.step(episode, seq, action(seq)) == reference[seq]
            assert lent(own)
            own.process.send_signal(signal.SIGTERM)
            for seq in range(10, len(reference)):
                assert drive.step(episode, seq, action(seq)) == reference[seq]
                time.sleep(0.01)
            closed = (CLOSE, (1012).to_bytes(2, "big"))
            assert (drive.frame(), silent.frame()) == (closed, closed)
        assert own.process.wait(30) == 0
        assert stored(own, episode)[1] not in {None, "aborted"}
    finally:
        assert own.stop() == 0, own.stderr
    assert "Traceback" not in own.stderr


@pytest.mark.parametrize("pause", [0.0, 0.002, 0.02])
def test_a_verdict_that_nobody_hears_is_told_again(
    service: RunningService, agent: Agent, drive: LentSocket, reference: Payloads, pause: float
) -> None:
    episode = agent.practise(**TRIAL)["id"]
    last = len(reference) - 1
    go_on(drive, episode, reference[:last], 0)
    assert lent(service)
    drive.send(["step", episode, last, *action(last)])
    time.sleep(pause)
    drive.raw.close()
    with LentSocket(service, agent.token) as again:
        assert again.step(episode, last, action(last)) == reference[last]
    assert stored(service, episode)[3] == last
