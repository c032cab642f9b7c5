"""How a simulator process answers steps on a client's connection."""

import select
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from wrongturn_protocol import Track, framing, wire
from wrongturn_service.encoding import step_tail
from wrongturn_service.simulators import action_log
from wrongturn_service.simulators.action_log import Action, rounded
from wrongturn_service.simulators.frames import Receiver
from wrongturn_service.simulators.interface import LOAN_S, SENDING_S
from wrongturn_service.simulators.shared_memory import PLACES, SharedMemoryWriter

if TYPE_CHECKING:
    from wrongturn_sim import Episode


_NUMBERS: Final = {float, int}
"""Some clients' languages know no other zero than the integer."""


class PlainStep(NamedTuple):
    """A step that asks for nothing but that."""

    episode: str
    seq: int
    action: Action


def plain_step(call: Any) -> PlainStep | None:
    """A call of ``WS /v1/drive`` as a step; None for any other, and for one with which something is wrong.

    Args:
        call: any of a message's.
    """
    if type(call) is not list or len(call) != 6 or call[0] != "step":
        return None
    _, episode, seq, steer, throttle, brake = call
    if type(episode) is not str or type(seq) is not int:
        return None
    if not type(steer) is type(throttle) is type(brake) is float and not {*map(type, call[3:])} <= _NUMBERS:
        return None
    if not (-1.0 <= steer <= 1.0 and 0.0 <= throttle <= 1.0 and 0.0 <= brake <= 1.0):
        return None
    return PlainStep(episode, seq, rounded(steer, throttle, brake))


_PIECE: Final = 1 << 16


@dataclass(slots=True)
class Loan:
    """A loan as the process knows it.

    Attributes:
        connection: the client's; it does not block.
        episode: its id.
        seq: of its last reply.
        place: where the next observation is written.
        practice: whether rewards are told.
    """

    connection: socket.socket
    episode: str
    seq: int
    place: int
    practice: bool


class Handover:
    """Answers steps until somebody else has to."""

    def __init__(
        self,
        service: socket.socket,
        requests: Receiver,
        writer: SharedMemoryWriter,
    ) -> None:
        """Nothing is lent yet.

        Args:
            service: the stream to the service; whatever comes there ends a loan.
            requests: what reads it.
            writer: where observations are written.
        """
        self._service = service
        self._requests = requests
        self._writer = writer

    def drive(self, loan: Loan, driven: "Episode", track: Track, finished: Callable[..., list[Any]]) -> list[Any]:
        """Answer steps.

        Args:
            loan: what is lent.
            driven: the episode.
            track: what is observed.
            finished: puts together the frame of the step that ended the episode.

        Returns:
            What is handed back: seconds of silence, what is unread, what is unsent, the step that ended the episode as
            ``[number, action, seconds, frame]`` or None, and whether it was only for its length that it ended.
        """
        book, connection = self._writer.action_log, loan.connection
        poll = select.poll()
        poll.register(self._service, select.POLLIN)
        poll.register(connection, select.POLLIN)
        service = self._service.fileno()
        heard = time.monotonic()
        deadline = heard + LOAN_S
        unread, unsent, last = b"", b"", None
        again = False
        while not self._requests.waiting:
            left = deadline - time.monotonic()
            ready = poll.poll(left * 1000) if left > 0 and book.count < action_log.STEPS else []
            if not ready:
                again = book.count > 0
                break
            if len(ready) > 1 or ready[0][0] == service:
                break
            began = time.perf_counter()
            book.read()
            try:
                data = connection.recv(_PIECE)
            except BlockingIOError:
                book.wait()
                continue
            except OSError:
                break  # the service finds out for itself
            if not data:
                break
            heard = time.monotonic()
            found = _taken(data, loan)
            if found is None:
                unread = data
                break
            number, step = found
            book.take(data)
            observation, reward, terminated, truncated = driven.step(*step.action)
            if terminated or truncated:
                simulated = time.perf_counter() - began
                last = [number, step.action, simulated, finished(observation, reward, terminated, truncated)]
                break
            unsent = self._answer(loan, number, step.action, track, observation, reward, began)
            if unsent:
                break
        return [time.monotonic() - heard, unread, unsent, last, again]

    def _answer(
        self, loan: Loan, number: int, action: Action, track: Track, observation: Any, reward: float, began: float
    ) -> bytes:
        """Note a step and tell of it; what of the reply was not taken."""
        shown = self._writer.write(observation, track, loan.place)
        loan.place = (loan.place + 1) % PLACES
        simulated = time.perf_counter() - began
        book = self._writer.action_log
        book.commit(action, reward)
        loan.seq += 1
        told = reward if loan.practice else None
        fields = dict((("seq", loan.seq), *step_tail(terminated=False, truncated=False, reward=told, verdict=None)))
        head = wire.results_head(number, 1) + wire.result_head(200, fields, len(shown))
        book.send()
        unsent = self._send(loan.connection, (framing.head(len(head) + len(shown)) + head, shown))
        book.finish(simulated, time.perf_counter() - began, sent=not unsent)
        return unsent

    def _send(self, connection: socket.socket, pieces: tuple[bytes | memoryview, ...]) -> bytes:
        """Send as much as is taken in time; what is left of it."""
        left = sum(map(len, pieces))
        try:
            left -= connection.sendmsg(pieces)
            if not left:
                return b""
        except BlockingIOError:
            pass
        except OSError:
            return b""  # nobody is there any more to take it
        rest = memoryview(b"".join(pieces))[-left:]
        poll = select.poll()
        poll.register(connection, select.POLLOUT)
        poll.register(self._service, select.POLLIN)
        deadline = time.monotonic() + SENDING_S
        while rest and (left_s := deadline - time.monotonic()) > 0:
            ready = poll.poll(left_s * 1000)
            if any(handle == self._service.fileno() for handle, _ in ready):
                break
            try:
                rest = rest[connection.send(rest) :]
            except BlockingIOError:
                continue
            except OSError:
                return b""
        return bytes(rest)


def _taken(data: bytes, loan: Loan) -> tuple[int, PlainStep] | None:
    """The number and the step of what has come, where it is one message with the episode's next step, and no more."""
    if len(data) > action_log.MESSAGE or data[0] != framing.BINARY:
        return None
    begin, end = framing.extent(data, 0, len(data))
    if end != len(data) or not data[1] & framing.MASKED:
        return None
    try:
        number, calls = wire.unpack_calls(framing.apply_mask(data[begin:end], data[begin - 4 : begin]))
    except wire.MalformedMessageError:
        return None
    step = plain_step(calls[0]) if len(calls) == 1 else None
    if step is None or step.episode != loan.episode or step.seq != loan.seq + 1:
        return None
    return number, step
