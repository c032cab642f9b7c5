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
from loan_story import TRIAL, Payloads, Story, action, fields, over, stored
from raw_socket import press
from service_harness import Agent, RunningService, expect
from test_drive_frames import BINARY, CLOSE, LIMIT, PING, TEXT, frame

from wrongturn_client.drive import Drive
from wrongturn_protocol import Action, Track, wire

# What ends the connection

ENDINGS = {
    "text": (frame(TEXT, b"hello"), 1003, "text-message"),
    "no msgpack": (frame(BINARY, b"\xc1"), 1007, "malformed-message"),
    "too large": (frame(BINARY, bytes(LIMIT + 1)), 1009, "message-too-large"),
    "a reserved bit": (frame(BINARY | 0x40, b"\x92\x01\x90"), 1002, ""),
    "a close": (frame(CLOSE, (1000).to_bytes(2, "big")), 1000, ""),
}


@pytest.fixture
def story(agent: Agent, drive: LentSocket, reference: Payloads) -> Story:
    story = Story(agent, drive, reference)
    story.begin_loan()
    return story


@pytest.mark.parametrize("name", ENDINGS)
def test_what_ends_the_connection(story: Story, name: str) -> None:
    data, code, kind = ENDINGS[name]
    drive = story.drive
    drive.raw.sendall(data)
    if kind:
        number, ((_, problem),) = wire.unpack_results(drive.receive())
        assert (number, problem["type"]) == (None, f"/problems/{kind}")
    last, reason = drive.frame()
    assert (last, reason[:2]) == (CLOSE, code.to_bytes(2, "big"))
    if kind:
        assert reason[2:].decode() == kind
    with LentSocket(drive.service, story.agent.token) as again:
        story.step(again)


@pytest.mark.parametrize("reset", [False, True])
@pytest.mark.parametrize("asked", [False, True])
def test_a_connection_that_is_dropped(story: Story, reset: bool, asked: bool) -> None:
    service, raw = story.drive.service, story.drive.raw
    if asked:
        story.drive.send(story.call())
    if reset:
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    os.close(raw.detach())
    until(lambda: not lent(service) and not figure(service, "wrongturn_sockets"), "it counts on")
    with LentSocket(service, story.agent.token) as again:
        story.step(again)
        story.go_on(again)


def test_an_episode_that_is_deleted(story: Story) -> None:
    assert story.agent.http.delete(f"/v1/episodes/{story.episode}").status_code == 204
    status, problem = story.drive.call(*story.call())
    assert (status, problem["type"]) == (409, "/problems/episode-finished")
    assert stored(story.drive.service, story.episode)[1:4:2] == ("aborted", story.seq)


def test_an_evaluation_that_is_closed(service: RunningService, agent: Agent, drive: LentSocket) -> None:
    evaluation = agent.evaluate()["id"]
    episode = expect(agent.reset(evaluation), 201)["id"]
    seq = 0
    while not lent(service):
        seq += 1
        assert not over(drive.step(episode, seq, action(seq)))
    assert seq > 1, "the first step counts before a connection is lent"
    assert expect(agent.http.delete(f"/v1/evaluations/{evaluation}"), 200)["state"] == "finished"
    status, problem = drive.call("step", episode, seq + 1, *action(seq + 1))
    assert (status, problem["type"]) == (409, "/problems/episode-finished")
    assert stored(service, episode)[1:4:2] == ("aborted", seq)
    assert drive.call(*LOOK)[0] == 404


@pytest.mark.parametrize("revoked", [False, True])
def test_a_token_that_is_no_longer_valid(story: Story, revoked: bool) -> None:
    agent, drive = story.agent, story.drive
    if revoked:
        assert agent.http.delete(f"/v1/agents/{agent.id}/token").status_code == 204
    else:
        renewed = expect(agent.http.post(f"/v1/agents/{agent.id}/token"), 201)
    drive.send(story.call())
    number, ((status, problem),) = wire.unpack_results(drive.receive())
    assert (number, status, problem["type"]) == (None, 401, "/problems/unauthenticated")
    assert drive.frame() == (CLOSE, (1008).to_bytes(2, "big") + b"unauthenticated")
    if not revoked:
        with Agent(drive.service.url, renewed) as back, LentSocket(drive.service, back.token) as again:
            story.go_on(again)


def test_loans_leave_no_handle_behind(service: RunningService, agent: Agent, reference: Payloads) -> None:
    def handles() -> dict[int, int]:
        return {pid: len(list(Path(f"/proc/{pid}/fd").iterdir())) for pid in (service.process.pid, *pids)}

    def drive_all() -> None:
        with LentSocket(service, agent.token) as drive:
            Story(agent, drive, reference).go_on()
        until(lambda: not figure(service, "wrongturn_sockets"), "a closed connection counts on")

    drive_all()
    pids = service.simulators()
    before = handles()
    for _ in range(5):
        drive_all()
    # Those of a request that ends or of the database come and go; each drive that kept one would add to them.
    until(lambda: all(now < before[pid] + 5 for pid, now in handles().items()), f"{before} became {handles()}")


@pytest.mark.parametrize("pause", [0.0, 0.02])
def test_a_verdict_that_nobody_hears_is_sent_again(story: Story, pause: float) -> None:
    last = len(story.reference) - 1
    while story.seq < last - 1:
        story.step()
    story.drive.send(story.call())
    time.sleep(pause)
    story.drive.raw.close()
    with LentSocket(story.drive.service, story.agent.token) as again:
        story.step(again)
    assert stored(story.drive.service, story.episode)[3] == last


# What dies, and what does not answer


@pytest.fixture(scope="module")
def fragile(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    """A service of little patience with its clients, whose simulators may be killed."""
    running = RunningService(
        tmp_path_factory.mktemp("fragile") / "wrongturn.db",
        simulators=2,
        spare_simulators=1,
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


def _drive_by_client(service: RunningService, agent: Agent, episode: str, reference: Payloads) -> None:
    with Drive(urlsplit(service.url), agent.token, timeout=60, patience=120) as client:
        for seq in range(1, len(reference)):
            time.sleep(0.001)  # so that there is a moment between two steps, too
            reply = client.step(episode, seq, Action.model_validate(fields(seq)))
            _, ((_, shown, block),) = wire.unpack_results(reference[seq])
            fields_shown = reply.model_dump(exclude_none=True)
            assert wire.block(fields_shown.pop("observation"), Track.PRIVILEGED) == block, seq
            assert fields_shown == shown


@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    ("number", "times"),
    [
        (signal.SIGKILL, 1),
        (signal.SIGSTOP, 1),
        pytest.param(signal.SIGKILL, 60, marks=pytest.mark.soak),
        pytest.param(signal.SIGSTOP, 20, marks=pytest.mark.soak),
    ],
)
def test_a_simulator_that_dies_or_hangs_at_any_moment(
    fragile: RunningService, reference: Payloads, number: int, times: int
) -> None:
    """A thread sends a signal to whichever simulator has the connection, while the client drives."""
    deaths = figure(fragile, "wrongturn_simulator_deaths_total")
    signalled: list[int] = []
    stop = threading.Event()
    dice = Random(times)

    def disturb() -> None:
        while not stop.is_set() and len(signalled) < times:
            time.sleep(0.02 + dice.random() * 0.08)
            for pid in set(borrowers(fragile)) - set(signalled):
                time.sleep(dice.random() * 0.004)
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, number)
                    if number == signal.SIGSTOP and pid not in borrowers(fragile):
                        os.kill(pid, signal.SIGCONT)  # it had given the connection back, so nobody waits for it
                    else:
                        signalled.append(pid)

    thread = threading.Thread(target=disturb)
    thread.start()
    try:
        with fragile.agent() as agent:
            # One that was killed after its drive is counted when the next one begins.
            while len(signalled) < times or figure(fragile, "wrongturn_simulator_deaths_total") == deaths:
                episode = agent.practise(**TRIAL)["id"]
                _drive_by_client(fragile, agent, episode, reference)
                assert stored(fragile, episode)[3] == len(reference) - 1
    finally:
        stop.set()
        thread.join()
    assert figure(fragile, "wrongturn_simulator_deaths_total") > deaths


def test_a_client_that_does_not_read_is_closed_and_goes_on_over_http(tmp_path: Path) -> None:
    # It reads no pings either, so the service has patience with those.
    own = RunningService(tmp_path / "wrongturn.db", simulators=1, slow_client_s=1.5, ping_timeout_s=600)
    closed = 'wrongturn_connections_closed_total{reason="slow-reader"}'
    try:
        with own.agent("segmentation") as agent, LentSocket(own, agent.token, receive_buffer=65536) as drive:
            episode = agent.practise(**TRIAL | {"track": "segmentation"})["id"]
            seq = 0
            while not lent(own):
                seq += 1
                drive.step(episode, seq, action(seq))
            steps = [["step", episode, min(at, seq + 9), *action(min(at, seq + 9))] for at in range(seq + 1, seq + 500)]
            left = memoryview(b"".join(frame(BINARY, wire.pack_calls(at, [step])) for at, step in enumerate(steps)))

            def over() -> bool:
                nonlocal left
                left = press(drive.raw, left, 0.5)
                return figure(own, closed) == 1

            until(over, "a client that never reads stays")
            until(lambda: not figure(own, "wrongturn_sockets") and not lent(own), "it counts on")
            taken = expect(agent.http.get(f"/v1/episodes/{episode}"), 200)["seq"]
            assert seq < taken <= seq + 9
            assert expect(agent.step(episode, taken + 1, fields(taken + 1)), 200)["seq"] == taken + 1
    finally:
        assert own.stop() == 0, own.stderr


@contextlib.contextmanager
def soon_connected(service: RunningService, agent: Agent, reference: Payloads) -> Iterator[Story]:
    """A story whose connection has no ping unanswered while its simulator starts."""
    episode = agent.practise(**TRIAL)["id"]
    with LentSocket(service, agent.token) as drive:
        yield Story(agent, drive, reference, episode)


def test_a_client_that_answers_no_ping_is_closed_between_two_replies(
    fragile: RunningService, reference: Payloads
) -> None:
    with fragile.agent() as agent, soon_connected(fragile, agent, reference) as story:
        drive = story.drive
        story.begin_loan()
        assert drive.frame()[0] == PING  # since it is silent; it is never answered
        received = (PING, b"")
        while received[0] != CLOSE:
            assert story.seq < len(reference) - 2
            story.seq += 1
            drive.send(story.call(0), number=story.seq)
            while (received := drive.frame())[0] == PING:
                pass
            assert received in [
                (BINARY, reference[story.seq]),
                (CLOSE, (1011).to_bytes(2, "big") + b"keepalive ping timeout"),
            ]
            time.sleep(0.06)  # so that the ping's time is over in the middle of the drive


def test_a_simulator_is_released_when_its_agent_falls_silent_in_a_loan(
    fragile: RunningService, reference: Payloads
) -> None:
    with fragile.agent() as agent, soon_connected(fragile, agent, reference) as story:
        story.begin_loan()
        until(lambda: not lent(fragile), "silence does not end a loan")
        until(lambda: figure(fragile, "wrongturn_leases_released") == 1, "its simulator is kept")
        with LentSocket(fragile, agent.token) as back:
            story.step(back)


def test_a_stop_in_a_loan(tmp_path: Path, reference: Payloads) -> None:
    own = RunningService(tmp_path / "wrongturn.db", simulators=2, shutdown_grace_s=600, ping_interval_s=600)
    try:
        with (
            own.agent() as agent,
            own.agent() as idle,
            LentSocket(own, agent.token) as drive,
            LentSocket(own, idle.token) as silent,
        ):
            Story(idle, silent, reference).begin_loan()
            story = Story(agent, drive, reference)
            while lent(own) < 2 and story.seq < 10:
                story.step()
            own.process.send_signal(signal.SIGTERM)
            while story.seq < len(reference) - 1:
                story.step()
                time.sleep(0.01)
            closed = (CLOSE, (1012).to_bytes(2, "big"))
            assert (drive.frame(), silent.frame()) == (closed, closed)
        assert own.process.wait(120) == 0
        assert stored(own, story.episode)[1] not in {None, "aborted"}
    finally:
        assert own.stop() == 0, own.stderr
    assert "Traceback" not in own.stderr
