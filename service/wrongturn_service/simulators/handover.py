"""How a simulator process answers steps on a connection that the service lends to it."""

import contextlib
import fcntl
import select
import signal
import socket
import termios
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from wrongturn_protocol import Track, framing, wire
from wrongturn_service.encoding import step_tail
from wrongturn_service.simulators.action_log import Action, rounded
from wrongturn_service.simulators.frames import Receiver
from wrongturn_service.simulators.shared_memory import PLACES, SharedMemoryWriter

if TYPE_CHECKING:
    from wrongturn_sim import Episode

_SEND_S: Final = 1.0
"""Seconds in which the kernel has to take a reply. It takes one at once, unless it holds others for a slow client."""
_READ_SIZE: Final = 1 << 16
_NUMBERS: Final = {float, int}
"""Some clients' languages write 0.0 as the integer 0."""
_NOTHING: Final = bytes(4)


class PlainStep(NamedTuple):
    """A step whose values are all valid."""

    episode: str
    seq: int
    action: Action


def plain_step(call: Any) -> PlainStep | None:
    """Return a call of ``WS /v1/drive`` as a step, or None if it is another call or not valid.

    Args:
        call: one item of a message.
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


class LentConnection:
    """A client's connection, for as long as this process answers the steps of one episode on it."""

    def __init__(
        self, client: socket.socket, writer: SharedMemoryWriter, place: int, episode: str, seq: int, practice: bool
    ) -> None:
        """Take over a connection.

        Args:
            client: the connection; it does not block.
            writer: where observations and steps are written.
            place: where the next observation goes.
            episode: its id.
            seq: of the episode's last reply.
            practice: whether replies carry rewards.
        """
        self._client = client
        self._writer = writer
        self._place = place
        self._episode = episode
        self._seq = seq
        self._practice = practice

    def answer_steps(
        self, driven: "Episode", track: Track, service: Receiver, limit_s: int, end: Callable[..., list[Any]]
    ) -> list[Any]:
        """Answer steps until the service wants the connection back, or has to answer what came.

        Args:
            driven: the episode.
            track: what is observed.
            service: the stream from the service; a request there ends the loan.
            limit_s: whole seconds after which a step that hangs ends this process.
            end: returns the worker's reply to the step that ends the episode.

        Returns:
            Bytes that were read and are not answered; and the step that ended the episode, as
            ``[number of its message, action, seconds, reply]``, or None.
        """
        log = self._writer.action_log
        poll = select.poll()
        poll.register(service, select.POLLIN)
        poll.register(self._client, select.POLLIN)
        while not service.waiting and not log.full:
            ready = poll.poll()
            if len(ready) > 1 or ready[0][0] == service.fileno():
                break
            began = time.perf_counter()
            try:
                data = self._client.recv(_READ_SIZE)
            except OSError:
                break  # the service meets the same error
            step = self._next_step(data)
            if step is None or self._has_unread_replies():
                return [data, None]
            number, action = step
            signal.alarm(limit_s)
            observation, reward, terminated, truncated = driven.step(*action)
            if terminated or truncated:
                simulated_s = time.perf_counter() - began
                # The reply carries this observation itself: both places may hold one that the client was sent.
                return [b"", [number, action, simulated_s, end(observation, reward, terminated, truncated)]]
            block = self._writer.write(observation, track, self._place)
            self._place = (self._place + 1) % PLACES
            log.add(action, reward, time.perf_counter() - began)
            signal.alarm(0)
            self._seq += 1
            if not self._send(self._reply(number, reward, block)):
                break
            log.sent(time.perf_counter() - began)
        return [b"", None]

    def _next_step(self, data: bytes) -> tuple[int, Action] | None:
        """Return the message's number and its action, if the data is one message with just the episode's next step."""
        if not data or data[0] != framing.BINARY:
            return None
        begin, end = framing.extent(data, 0, len(data))
        if end != len(data) or not data[1] & framing.MASKED:
            return None
        try:
            number, calls = wire.unpack_calls(framing.apply_mask(data[begin:end], data[begin - 4 : begin]))
        except wire.MalformedMessageError:
            return None
        step = plain_step(calls[0]) if len(calls) == 1 else None
        if step is None or step.episode != self._episode or step.seq != self._seq + 1:
            return None
        return number, step.action

    def _has_unread_replies(self) -> bool:
        """Whether the client sends steps before it has received the replies: only the service can wait for that."""
        return fcntl.ioctl(self._client, termios.TIOCOUTQ, _NOTHING) != _NOTHING

    def _reply(self, number: int, reward: float, block: memoryview) -> tuple[bytes, memoryview]:
        tail = step_tail(terminated=False, truncated=False, reward=reward if self._practice else None, verdict=None)
        fields = dict((("seq", self._seq), *tail))
        head = wire.results_head(number, 1) + wire.result_head(200, fields, len(block))
        return framing.head(len(head) + len(block)) + head, block

    def _send(self, message: tuple[bytes, memoryview]) -> bool:
        """Send a message, or end the connection of a client that is too slow to take it; return whether it is sent."""
        size = sum(map(len, message))
        try:
            sent = self._client.sendmsg(message)
            if sent < size:
                self._client.settimeout(_SEND_S)
                self._client.sendall(b"".join(message)[sent:])
                self._client.settimeout(0)
        except OSError:
            # The client has left, or has half a message: it connects again and asks for the step by its seq.
            with contextlib.suppress(OSError):
                self._client.shutdown(socket.SHUT_RDWR)
            return False
        return True
