"""The log of a loan: whenever the process dies, every step whose reply was sent is in it."""

import contextlib
import mmap
import os
import select
import signal
import socket
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_shared_memory import observed, writer_of

from wrongturn_protocol import Track, framing, wire
from wrongturn_service.simulators import action_log, frames, handover
from wrongturn_service.simulators.action_log import ACTION, ActionLog, LogEntries, rounded
from wrongturn_service.simulators.handover import LentConnection
from wrongturn_service.simulators.shared_memory import SharedMemory

LOAN = 7
EPISODE = "ep_toy"
STEPS = 3
OBSERVED = {track: [observed(track, seq) for seq in range(STEPS + 2)] for track in (Track.STATE, Track.CAMERA)}
float32 = st.floats(0, 1, width=32)
steps = st.tuples(st.tuples(float32, float32, float32), st.floats(allow_nan=False), float32, float32)


@settings(max_examples=60)
@given(loans=st.lists(st.lists(steps, max_size=5), min_size=1, max_size=4), first=st.integers(0, 6))
def test_what_is_added_is_read(loans: list[list[tuple[Any, float, float, float]]], first: int) -> None:
    memory = mmap.mmap(-1, action_log.SIZE)
    log, service = ActionLog(memoryview(memory)), ActionLog(memoryview(memory).toreadonly())
    for number, loan in enumerate(loans, 1):
        assert service.read(number) == LogEntries(b"", 0.0, ())  # whatever an earlier loan has left
        log.begin(number)
        for count, step in enumerate(loan, 1):
            log.add(*step[:3])
            seconds = (*(one[2:] for one in loan[: count - 1]), (step[2], 0.0))
            actions = b"".join(ACTION.pack(*one[0]) for one in loan[:count])
            assert service.read(number) == LogEntries(actions, step[1], seconds)
            log.sent(step[3])
            assert service.read(number, first, 2).seconds == tuple(one[2:] for one in loan[first:count][:2])


class Toy:
    """An episode that costs nothing but a fork."""

    def __init__(self, track: Track) -> None:
        self._track = track
        self._count = 0

    def step(self, *taken: float) -> tuple[Any, float, bool, bool]:
        self._count += 1
        assert taken == action(self._count)
        return OBSERVED[self._track][self._count], self._count / 2, False, False


def action(seq: int) -> tuple[float, float, float]:
    return rounded(seq / 10, 0.5, 0.0)


def message(seq: int) -> bytes:
    payload = wire.pack_calls(100 + seq, [["step", EPISODE, seq, *action(seq)]])
    return framing.head(len(payload), masked=True) + b"mask" + framing.apply_mask(payload, b"mask")


def reply(seq: int, track: Track) -> bytes:
    shown = {"seq": seq, "terminated": False, "truncated": False, "reward": seq / 2}
    payload = wire.join_results(100 + seq, [wire.pack_result(200, shown, wire.block(OBSERVED[track][seq], track))])
    return framing.head(len(payload)) + payload


@dataclass
class Ended:
    """What is left of a loan that ended by itself, or at some line of code."""

    entries: LogEntries
    shown: bytes
    received: bytes
    handed_back: list[Any] | None


def lent(track: Track, lines: int = sys.maxsize, *, ahead: bool = False, reads: bool = True) -> Ended:
    """Lend a connection to a process that is killed after so many lines of its own code.

    Args:
        track: what is observed.
        lines: see above.
        ahead: whether the client sends its second step before it reads the first reply.
        reads: whether the client reads before the process has ended.
    """
    shared = SharedMemory()
    writer = writer_of(shared)
    place = shared.free_all()
    with contextlib.ExitStack() as stack:
        ours, theirs, client, connection = (
            stack.enter_context(one) for one in (*socket.socketpair(), *socket.socketpair())
        )
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        connection.setblocking(False)
        pid = os.fork()
        if not pid:
            try:
                client.close()
                ours.close()
                sys.settrace(_deadly(lines))
                writer.action_log.begin(LOAN)
                toy: Any = Toy(track)
                one = LentConnection(connection, writer, place, EPISODE, 0, practice=True)
                back = one.answer_steps(toy, track, frames.Receiver(theirs), 60, lambda *_: [])
                sys.settrace(None)
                theirs.sendall(frames.pack(back))
            finally:
                os._exit(0)
        connection.close()
        theirs.close()
        received = b""
        with contextlib.suppress(ConnectionError):
            client.sendall(message(1))
            if ahead:
                select.select([client], [], [])
            if reads:
                for seq in range(1, STEPS + 1):
                    if seq > 1:
                        client.sendall(message(seq))
                    while len(received) < sum(len(reply(before, track)) for before in range(1, seq + 1)):
                        received += (piece := client.recv(1 << 20))
                        if not piece:
                            raise ConnectionError
                ours.sendall(frames.pack(["recall"]))
            elif ahead:
                client.sendall(message(2))
        _, status = os.waitpid(pid, 0)
        assert status in {0, signal.SIGKILL}
        with contextlib.suppress(ConnectionError):
            while piece := client.recv(1 << 20):
                received += piece
        entries = shared.action_log.read(LOAN)
        count = len(entries.seconds)
        shown = bytes(shared.last_view(place, count, wire.layout(track).size)) if count else b""
        return Ended(entries, shown, received, frames.Receiver(ours).receive() if status == 0 else None)


def _deadly(lines: int) -> Callable[[Any, str, Any], Any]:
    def count(_frame: Any, event: str, _argument: Any) -> Any:
        nonlocal lines
        if event == "line":
            if not lines:
                os.kill(os.getpid(), signal.SIGKILL)
            lines -= 1
        return count

    files = {handover.__file__, action_log.__file__}
    return lambda frame, *_: count if frame.f_code.co_filename in files else None


def _check(ended: Ended, track: Track) -> int:
    """Check that the log holds each step whose reply was sent, if only in part; the number of whole replies."""
    whole, rest = 0, ended.received
    while rest.startswith(expected := reply(whole + 1, track)):
        whole, rest = whole + 1, rest[len(expected) :]
    assert reply(whole + 1, track).startswith(rest)
    count = len(ended.entries.seconds)
    assert whole + bool(rest) <= count <= whole + 1
    assert ended.entries.actions == b"".join(ACTION.pack(*action(seq)) for seq in range(1, count + 1))
    if count:
        assert ended.entries.reward == count / 2
        assert ended.shown == wire.block(OBSERVED[track][count], track)
    return whole


@pytest.mark.parametrize(
    ("track", "every"),
    [
        (Track.STATE, 5),
        (Track.CAMERA, 9),
        pytest.param(Track.STATE, 1, marks=pytest.mark.soak),
        pytest.param(Track.CAMERA, 1, marks=pytest.mark.soak),
    ],
)
def test_a_process_may_die_at_any_line(track: Track, every: int) -> None:
    lines = 0
    while (ended := lent(track, lines)).handed_back is None:
        _check(ended, track)
        lines += every
    assert lines > 30
    assert _check(ended, track) == STEPS
    assert ended.handed_back == [b"", None]


def test_a_full_log_ends_the_loan(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(action_log, "STEPS", 2)
    ended = lent(Track.STATE)
    assert _check(ended, Track.STATE) == 2
    assert ended.handed_back == [b"", None]


def test_a_client_that_does_not_read_gets_no_further_reply_from_the_simulator() -> None:
    ended = lent(Track.STATE, ahead=True, reads=False)
    assert _check(ended, Track.STATE) == 1
    assert ended.handed_back == [message(2), None]


def test_a_client_that_does_not_take_a_reply_is_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(handover, "_SEND_S", 0.1)
    ended = lent(Track.CAMERA, reads=False)
    assert _check(ended, Track.CAMERA) == 0
    assert 0 < len(ended.received) < len(reply(1, Track.CAMERA))
    assert len(ended.entries.seconds) == 1
