# ruff: noqa: B023 - the nested function is called within its own round of the loop
"""What a simulator process notes of a loan: whenever it dies, what a client was told and what it asked for is known."""

import contextlib
import mmap
import os
import select
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_shared_memory import observed, writer_of

from wrongturn_protocol import Track, framing, wire
from wrongturn_service.simulators import action_log, frames, handover
from wrongturn_service.simulators.action_log import ACTION, ActionLog, State, rounded
from wrongturn_service.simulators.handover import Handover, Loan
from wrongturn_service.simulators.shared_memory import SharedMemory

LOAN = 7
EPISODE = "ep_toy"
STEPS = 2
OBSERVED = {track: [observed(track, seq) for seq in range(STEPS + 2)] for track in (Track.STATE, Track.CAMERA)}
RECALL = frames.pack(["recall"])
float32 = st.floats(0, 1, width=32)
notes = st.tuples(
    st.binary(min_size=1, max_size=action_log.MESSAGE),
    st.tuples(st.floats(-1, 1, width=32), float32, float32),
    st.floats(allow_nan=False),
    st.tuples(float32, float32),
    st.booleans(),
)


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(loans=st.lists(st.lists(notes, max_size=5), min_size=1, max_size=4))
def test_what_is_noted_is_read(loans: list[list[tuple[bytes, tuple[float, float, float], float, tuple, bool]]]) -> None:
    memory = memoryview(mmap.mmap(-1, action_log.SIZE))
    book = ActionLog(memory)
    for number, steps in enumerate(loans, 1):
        assert action_log.read(memory, number).steps == 0  # of this loan nothing is noted yet
        book.open(number)
        actions, seconds, reward = b"", [], 0.0

        def told(state: State, message: bytes = b"") -> bool:
            return action_log.read(memory, number) == action_log.LogEntries(
                state, actions, reward, tuple(seconds), message
            )

        assert told(State.WAITING)
        for message, action, gained, spent, sent in steps:
            book.read()
            assert told(State.READING)
            book.wait()
            assert told(State.WAITING)
            book.read()
            book.take(message)
            assert told(State.ANSWERING, message)
            book.commit(action, gained)
            actions, reward = actions + ACTION.pack(*action), gained
            seconds.append((0.0, 0.0))
            assert told(State.ANSWERING, message)
            book.send()
            assert told(State.SENDING)
            book.finish(*spent, sent=sent)
            seconds[-1] = spent
            assert told(State.WAITING if sent else State.SENDING)
            assert action_log.read(memory, number).broken is not sent


def test_a_ledger_has_room_for_all_steps_of_a_loan() -> None:
    memory = memoryview(mmap.mmap(-1, action_log.SIZE))
    book = ActionLog(memory)
    book.open(1)
    for step in range(action_log.STEPS):
        book.take(bytes([step % 256]) * action_log.MESSAGE)
        book.commit((step / 1024, 0.0, 1.0), float(step))
        book.send()
        book.finish(step / 2, float(step))
    entries = action_log.read(memory, 1)
    assert entries.steps == action_log.STEPS
    assert list(ACTION.iter_unpack(entries.actions)) == [(step / 1024, 0.0, 1.0) for step in range(action_log.STEPS)]
    assert entries.seconds == tuple((step / 2, float(step)) for step in range(action_log.STEPS))
    assert entries.reward == action_log.STEPS - 1


class Toy:
    """An episode that costs nothing but a fork."""

    def __init__(self, track: Track, before: Callable[[int], None]) -> None:
        self._track = track
        self._before = before
        self._count = 0

    def step(self, steer: float, throttle: float, brake: float) -> tuple[Any, float, bool, bool]:
        assert (steer, throttle, brake) == action(self._count + 1)
        self._count += 1
        self._before(self._count)
        return OBSERVED[self._track][self._count], self._count / 2, self._count > STEPS, False


def action(seq: int) -> tuple[float, float, float]:
    return rounded(seq / 10, 0.5, 0.0)


def message(seq: int) -> bytes:
    payload = wire.pack_calls(100 + seq, [["step", EPISODE, seq, *action(seq)]])
    return framing.head(len(payload), masked=True) + b"mask" + framing.apply_mask(payload, b"mask")


def reply(seq: int, track: Track) -> bytes:
    fields = {"seq": seq, "terminated": False, "truncated": False, "reward": seq / 2}
    payload = wire.join_results(100 + seq, [wire.pack_result(200, fields, wire.block(OBSERVED[track][seq], track))])
    return framing.head(len(payload)) + payload


@dataclass
class Came:
    """What came of a loan that ended by itself, or at some line."""

    entries: action_log.LogEntries
    shown: bytes
    sent: int
    replies: bytes
    left: bytes
    handed_back: list[Any] | None


def driven(track: Track, lines: int, *, reads: bool, recalled_at: int = 0) -> Came:
    """A loan of a process that is killed after so many lines of its own code.

    Args:
        track: what is observed.
        lines: see above.
        reads: whether the client reads meanwhile; it sends its next step after each reply, else one alone.
        recalled_at: the step during which the loan is recalled.
    """
    shared = SharedMemory()
    writer = writer_of(shared)
    first = shared.clear()
    with contextlib.ExitStack() as stack:
        ours, theirs, client, connection = (
            stack.enter_context(one) for one in (*socket.socketpair(), *socket.socketpair())
        )
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        connection.setblocking(False)
        pid = os.fork()
        if not pid:

            def before(seq: int) -> None:
                if seq == recalled_at:
                    ours.sendall(RECALL)

            try:
                sys.settrace(_deadly(lines))
                writer.action_log.open(LOAN)
                loan = Loan(connection, EPISODE, 0, first, practice=True)
                toy: Any = Toy(track, before)
                came = Handover(theirs, frames.Receiver(theirs), writer).drive(loan, toy, track, lambda *_: [])
                sys.settrace(None)
                theirs.sendall(frames.pack(came))
            finally:
                os._exit(0)
        sent, replies = 1, b""
        client.sendall(message(1))
        with os.fdopen(os.pidfd_open(pid), "rb") as end:
            poll = select.poll()
            poll.register(end, select.POLLIN)
            if reads:
                poll.register(client, select.POLLIN)
            while not any(handle == end.fileno() for handle, _ in poll.poll()):
                replies += client.recv(1 << 20)
                if len(replies) == sum(len(reply(seq, track)) for seq in range(1, sent + 1)):
                    if sent < STEPS:
                        sent += 1
                        client.sendall(message(sent))
                    else:
                        ours.sendall(RECALL)
                        poll.unregister(client)
        _, status = os.waitpid(pid, 0)
        assert status in {0, signal.SIGKILL}
        replies += b"".join(_all(client))
        entries = shared.book(LOAN)
        shown = bytes(shared.last_view(first, entries.steps, wire.layout(track).size)) if entries.steps else b""
        back = frames.Receiver(ours).receive() if status == 0 else None
        unread = entries.message if back is None else back[1]
        left = unread + b"".join(_all(connection))
    return Came(entries, shown, sent, replies, left, back)


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


def _all(connection: socket.socket) -> Iterator[bytes]:
    connection.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        while data := connection.recv(1 << 20):
            yield data


@pytest.mark.parametrize(
    ("track", "reads", "recalled_at"),
    [(Track.STATE, True, 0), (Track.STATE, True, 2), (Track.CAMERA, True, 0), (Track.CAMERA, False, 1)],
)
def test_a_process_may_die_at_any_line(track: Track, reads: bool, recalled_at: int) -> None:
    lines, ended = 0, False
    broken = 0
    while not ended:
        came = driven(track, lines, reads=reads, recalled_at=recalled_at)
        ended = came.handed_back is not None
        entries = came.entries
        whole = 0
        told = came.replies
        while told.startswith(expected := reply(whole + 1, track)):
            whole, told = whole + 1, told[len(expected) :]
        assert reply(whole + 1, track).startswith(told), lines
        # What was told is noted, and what was noted is shown.
        assert entries.steps >= whole + bool(told), lines
        assert list(ACTION.iter_unpack(entries.actions)) == [action(seq) for seq in range(1, entries.steps + 1)]
        if entries.steps:
            assert entries.reward == entries.steps / 2, lines
            assert came.shown == wire.block(OBSERVED[track][entries.steps], track), lines
        if came.handed_back is not None:
            _, _, unsent, last, _ = came.handed_back
            assert last is None
            assert told + unsent in {b"", reply(whole + 1, track)}
            assert entries.steps == whole + bool(unsent)
            assert came.left == b""
        elif entries.broken:
            broken += 1
        else:
            # The client goes on as if nothing had been: each of its messages is answered, or still to be.
            assert told == b"", lines
            assert came.left == (message(came.sent) if came.sent > whole else b""), lines
        lines += 1
    assert lines > 20
    assert broken
