"""One simulator as a process of this machine."""

import asyncio
import os
import socket
import subprocess
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from typing_extensions import override

from wrongturn_protocol import Outcome, Track
from wrongturn_protocol.wire import layout
from wrongturn_service.encoding import Encoding
from wrongturn_service.simulators import frames
from wrongturn_service.simulators.action_log import Action
from wrongturn_service.simulators.interface import (
    LOAN_S,
    SENDING_S,
    EpisodeEnd,
    EpisodeRefusedError,
    LastStep,
    LoanRequest,
    LoanResult,
    Simulator,
    SimulatorDiedError,
    SimulatorError,
    SimulatorStartError,
    StepResult,
    replay_s,
)
from wrongturn_service.simulators.shared_memory import SharedMemory

_T = TypeVar("_T")
_RECALL = frames.pack(["recall"])
_STEP_S = 5.0
"""Seconds after which a step hangs: it takes milliseconds, where a reset may have a town to load."""


class _Stream(asyncio.Protocol):
    """The stream to a process: one request out, one reply in."""

    def __init__(self) -> None:
        self.closed = False
        self._waiting: asyncio.Future[Any] | None = None
        self._read: Callable[[list[Any]], Any] = list
        self._splitter = frames.Splitter()

    @property
    def waiting(self) -> "asyncio.Future[Any] | None":
        """What a reply is waited for by, where one is."""
        return None if self._waiting is None or self._waiting.done() else self._waiting

    def expect(self, waiting: "asyncio.Future[_T]", read: Callable[[list[Any]], _T]) -> None:
        """Let the next reply be read and given to somebody."""
        self._waiting, self._read = waiting, read
        if self.closed:
            self.fail("the simulator process ended")

    def fail(self, reason: str) -> None:
        """Tell who waits that nothing comes."""
        if self.waiting is not None:
            self.waiting.set_exception(SimulatorDiedError(reason))

    @override
    def data_received(self, data: bytes) -> None:
        for value in self._splitter.feed(data):
            waiting = self.waiting
            if waiting is not None:
                try:
                    waiting.set_result(self._read(value))
                except SimulatorError as error:
                    waiting.set_exception(error)

    @override
    def connection_lost(self, exc: Exception | None) -> None:
        self.closed = True
        self.fail("the simulator process ended")


class LocalSimulator(Simulator):
    """One process; use :meth:`start`."""

    def __init__(
        self,
        process: subprocess.Popen[bytes],
        stream: socket.socket,
        transport: asyncio.Transport,
        line: _Stream,
        shared: SharedMemory,
        timeout_s: float,
    ) -> None:
        self.process = process
        self.town = ""
        """What it has loaded."""
        self._stream = stream
        self._transport = transport
        self._line = line
        self._shared = shared
        self._timeout_s = timeout_s
        self._step_s = min(timeout_s, _STEP_S)
        self._loop = asyncio.get_running_loop()
        self._alarm: asyncio.TimerHandle | None = None
        self._limit_s = timeout_s
        self._deadline = 0.0
        self._loans = 0

    @classmethod
    async def start(
        cls,
        command: Sequence[str],
        environment: Mapping[str, str],
        *,
        start_timeout_s: float,
        timeout_s: float,
    ) -> "LocalSimulator":
        """Start a process and wait until it is ready.

        Raises:
            SimulatorStartError: it ended, or was not ready in time.
        """
        ours, theirs = socket.socketpair()
        shared = SharedMemory()
        with theirs, shared.lent() as shared_handle:
            handle = theirs.fileno()

            def spawn() -> subprocess.Popen[bytes]:
                return subprocess.Popen(  # noqa: S603 - our own program
                    [*command, str(handle), str(int(timeout_s) + 1), str(shared_handle)],
                    pass_fds=[handle, shared_handle],
                    stdin=subprocess.DEVNULL,
                    # What SUMO prints must not get between the lines of the service's own stdout.
                    stdout=2,
                    env={**os.environ, **environment},
                )

            try:
                process = await asyncio.to_thread(spawn)
            except OSError as error:
                ours.close()
                raise SimulatorStartError(f"no simulator process could be started: {error}") from error
        ours.setblocking(False)
        transport, line = await asyncio.get_running_loop().create_unix_connection(_Stream, sock=ours)
        simulator = cls(process, ours, transport, line, shared, timeout_s)
        try:
            await simulator._finished(simulator._expected(lambda reply: reply, start_timeout_s))
        except SimulatorDiedError as error:
            await simulator.close()
            status = process.returncode
            raise SimulatorStartError(
                f"a simulator process did not get ready ({error}, status {status}); what it said is on stderr, "
                "and 'wrongturn doctor' checks the installation",
            ) from error
        except BaseException:
            await simulator.close()
            raise
        return simulator

    @property
    @override
    def dead(self) -> bool:
        return self._line.closed

    @override
    async def reset(self, trial: str, track: Track, actions: bytes, encoding: Encoding) -> StepResult:
        request: list[object] = ["reset", trial, track.value, actions, encoding.value, self._shared.next_place()]
        return await self._finished(self._asked(request, self._frame, self._timeout_s + replay_s(actions)))

    @override
    async def step(self, action: Action, encoding: Encoding) -> StepResult:
        return await self._finished(self.begin_step(action, encoding))

    @override
    def begin_step(self, action: Action, encoding: Encoding) -> "asyncio.Future[StepResult]":
        return self._asked(["step", *action, encoding.value, self._shared.next_place()], self._frame, self._step_s)

    @override
    async def abort(self) -> EpisodeEnd:
        return await self._finished(self._asked(["abort"], lambda reply: _final(reply[1]), self._timeout_s))

    @property
    @override
    def lends(self) -> bool:
        return not self.dead and not self._transport.get_write_buffer_size()

    @override
    def lend(self, loan: LoanRequest) -> "asyncio.Future[LoanResult]":
        self._loans += 1
        first = self._shared.clear()
        request = frames.pack(["lend", self._loans, first, loan.episode, loan.seq, loan.practice])
        returned: asyncio.Future[LoanResult] = self._loop.create_future()

        def done(answered: "asyncio.Future[list[Any]]") -> None:
            if answered.exception() is None:
                returned.set_result(self._returned(loan, first, answered.result()))
            else:
                # As long as it lives it may note, and tell the client, what would be answered here again.
                self.kill()
                self._loop.run_in_executor(None, self.process.wait).add_done_callback(ended)

        def ended(_: "asyncio.Future[int]") -> None:
            returned.set_result(self._returned(loan, first, None))

        self._expected(self._sound, LOAN_S + SENDING_S + self._step_s).add_done_callback(done)
        try:
            socket.send_fds(self._stream, [request], [loan.handle])
        except OSError as error:
            self._line.fail(f"the simulator process could not be asked: {error}")
            self.kill()
        return returned

    @override
    def recall(self) -> None:
        if not self.dead:
            frames.write_now(self._transport, self._stream.fileno(), [_RECALL])

    def _returned(self, loan: LoanRequest, first: int, reply: list[Any] | None) -> LoanResult:
        """What came of a loan, by the reply and by what is noted; without one it has died of it."""
        book = self._shared.book(self._loans)
        observation = self._shared.last_view(first, book.steps, layout(loan.track).size) if book.steps else None
        if reply is None:
            return LoanResult(
                book.actions,
                book.seconds,
                book.reward,
                observation,
                unread=book.message,
                broken=book.broken,
            )
        _, silence_s, unread, unsent, last, again = reply
        if last is not None:
            number, action, seconds, frame = last
            last = LastStep(number, tuple(action), self._frame(frame), seconds)
        return LoanResult(book.actions, book.seconds, book.reward, observation, silence_s, unread, unsent, last, again)

    async def prepare(self, town: str) -> None:
        """Load a town, so that the first reset there takes no longer than any. Raises SimulatorDiedError."""
        await self._finished(self._asked(["prepare", town], lambda _: None, self._timeout_s))
        self.town = town

    def kill(self) -> None:
        """End it at once; whoever waits for it hears of it."""
        self._line.closed = True
        self._transport.abort()
        self.process.kill()
        if self._alarm is not None:
            self._alarm.cancel()
            self._alarm = None

    async def close(self) -> None:
        """End it and wait until it is gone."""
        self.kill()
        await asyncio.to_thread(self.process.wait)

    def _asked(self, request: list[object], read: Callable[[list[Any]], _T], timeout_s: float) -> "asyncio.Future[_T]":
        """Send a request; what comes of its reply."""
        if not self.dead:
            frames.write_now(self._transport, self._stream.fileno(), [frames.pack(request)])
        return self._expected(lambda reply: read(self._sound(reply)), timeout_s)

    def _sound(self, reply: list[Any]) -> list[Any]:
        """A reply that is none of an error. Raises EpisodeRefusedError, SimulatorDiedError."""
        if reply[0] == frames.REFUSED:
            raise EpisodeRefusedError(reply[1], reply[2])
        if reply[0] != frames.OK:
            # What state it is in nobody knows: the next episode must not inherit it.
            self.kill()
            raise SimulatorDiedError(f"{reply[1]}: {reply[2]}")
        return reply

    def _expected(self, read: Callable[[list[Any]], _T], timeout_s: float) -> "asyncio.Future[_T]":
        waiting: asyncio.Future[_T] = self._loop.create_future()
        self._line.expect(waiting, read)
        self._limit_s, self._deadline = timeout_s, self._loop.time() + timeout_s
        self._set_alarm()
        return waiting

    async def _finished(self, waiting: "asyncio.Future[_T]") -> _T:
        try:
            return await waiting
        except asyncio.CancelledError:
            # Its reply would be taken for the next request's.
            self.kill()
            raise

    def _set_alarm(self) -> None:
        """Look when the deadline has come; an alarm that rings earlier is left to be set again then, not each time."""
        if self._alarm is not None:
            if self._alarm.when() <= self._deadline:
                return
            self._alarm.cancel()
        self._alarm = self._loop.call_at(self._deadline, self._ring)

    def _ring(self) -> None:
        self._alarm = None
        if self._line.waiting is None:
            return
        if self._loop.time() < self._deadline:
            self._set_alarm()
            return
        self._line.fail(f"the simulator process did not answer within {self._limit_s:g} s")
        self.kill()

    def _frame(self, reply: list[Any]) -> StepResult:
        _, observation, reward, terminated, truncated, final = reply
        shown = self._shared.view(observation) if isinstance(observation, int) else observation
        return StepResult(shown, reward, terminated, truncated, None if final is None else _final(final))


def _final(values: list[Any]) -> EpisodeEnd:
    outcome, steps, trajectory, trajectory_sha256, actions_sha256 = values
    return EpisodeEnd(Outcome.model_validate_json(outcome), steps, trajectory, trajectory_sha256, actions_sha256)
