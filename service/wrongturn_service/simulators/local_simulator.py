"""One simulator as a process of this machine."""

import asyncio
import socket
import subprocess
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeVar

from typing_extensions import override

from wrongturn_protocol import Outcome, Track
from wrongturn_service.child_environment import child_environment
from wrongturn_service.encoding import Encoding
from wrongturn_service.simulators import frames
from wrongturn_service.simulators.actions import Action
from wrongturn_service.simulators.interface import (
    EpisodeEnd,
    EpisodeRefusedError,
    Simulator,
    SimulatorDiedError,
    SimulatorError,
    SimulatorStartError,
    StepResult,
    replay_s,
)
from wrongturn_service.simulators.shared_memory import SharedMemory

_T = TypeVar("_T")
_STEP_S: Final = 5.0
"""Seconds after which a step counts as hung. It takes milliseconds; only a reset may have to load a town."""
_ENDED: Final = "the simulator process ended"
_PASSED_ON: Final = (
    "WRONGTURN_HOME",
    "WRONGTURN_KERNELS",
    "SUMO_HOME",
    "NUMBA_CACHE_DIR",
    "NUMBA_CPU_NAME",
    "NUMBA_CPU_FEATURES",
    "NUMBA_DISABLE_JIT",
    "NUMBA_NUM_THREADS",
)
"""Variables that a process gets beside every child's: where towns and compiled code are, and for which processor."""


class _ProcessConnection(asyncio.Protocol):
    """Connection to a process, which answers one request at a time."""

    def __init__(self) -> None:
        self.closed = False
        self._reply: asyncio.Future[Any] | None = None
        self._read: Callable[[list[Any]], Any] = list
        self._splitter = frames.Splitter()

    @property
    def awaited(self) -> "asyncio.Future[Any] | None":
        """The reply that has not come yet."""
        return None if self._reply is None or self._reply.done() else self._reply

    def expect(self, reply: "asyncio.Future[_T]", read: Callable[[list[Any]], _T]) -> None:
        """Read the next frame as a reply."""
        self._reply, self._read = reply, read
        if self.closed:
            self.fail(_ENDED)

    def fail(self, reason: str) -> None:
        """Let the awaited reply fail."""
        if self.awaited is not None:
            self.awaited.set_exception(SimulatorDiedError(reason))

    @override
    def data_received(self, data: bytes) -> None:
        for frame in self._splitter.feed(data):
            reply = self.awaited
            if reply is not None:
                try:
                    reply.set_result(self._read(frame))
                except SimulatorError as error:
                    reply.set_exception(error)

    @override
    def connection_lost(self, exc: Exception | None) -> None:
        self.closed = True
        self.fail(_ENDED)


class LocalSimulator(Simulator):
    """One process; make it by :meth:`start`."""

    def __init__(
        self,
        process: subprocess.Popen[bytes],
        stream: socket.socket,
        transport: asyncio.Transport,
        connection: _ProcessConnection,
        shared: SharedMemory,
        timeout_s: float,
    ) -> None:
        self.process = process
        self.town = ""
        """The town that is loaded."""
        self._stream = stream
        self._transport = transport
        self._connection = connection
        self._shared = shared
        self._timeout_s = timeout_s
        self._step_s = min(timeout_s, _STEP_S)
        self._loop = asyncio.get_running_loop()
        self._alarm: asyncio.TimerHandle | None = None
        self._limit_s = timeout_s
        self._deadline = 0.0

    @classmethod
    async def start(
        cls, command: Sequence[str], environment: Mapping[str, str], *, start_timeout_s: float, timeout_s: float
    ) -> "LocalSimulator":
        """Start a process and wait until it is ready.

        Args:
            command: the program; the socket's descriptor, whole seconds of a call, and the shared memory's descriptor
                are added.
            environment: variables of the process, beside the few that it gets of this process's.
            start_timeout_s: seconds until it has to be ready.
            timeout_s: seconds after which a call counts as hung.

        Raises:
            SimulatorStartError: it ended, or was not ready in time.
        """
        ours, theirs = socket.socketpair()
        shared = SharedMemory()
        with theirs, shared.inherited() as shared_handle:
            handle = theirs.fileno()

            def spawn() -> subprocess.Popen[bytes]:
                return subprocess.Popen(  # noqa: S603 - our own program
                    [*command, str(handle), str(int(timeout_s) + 1), str(shared_handle)],
                    pass_fds=[handle, shared_handle],
                    stdin=subprocess.DEVNULL,
                    # What SUMO prints must not mix with what the service prints on stdout.
                    stdout=2,
                    env={**child_environment(*_PASSED_ON), **environment},
                )

            try:
                process = await asyncio.to_thread(spawn)
            except OSError as error:
                ours.close()
                raise SimulatorStartError(f"no simulator process could be started: {error}") from error
        ours.setblocking(False)
        transport, connection = await asyncio.get_running_loop().create_unix_connection(_ProcessConnection, sock=ours)
        simulator = cls(process, ours, transport, connection, shared, timeout_s)
        try:
            await simulator._finished(simulator._expect(lambda reply: reply, start_timeout_s))
        except SimulatorDiedError as error:
            await simulator.close()
            status = process.returncode
            raise SimulatorStartError(
                f"a simulator process did not get ready ({error}, status {status}); what it said is on stderr, "
                "and 'wrongturn doctor' checks the installation"
            ) from error
        except BaseException:
            await simulator.close()
            raise
        return simulator

    @property
    @override
    def dead(self) -> bool:
        return self._connection.closed

    @override
    async def reset(self, trial: str, track: Track, actions: bytes, encoding: Encoding) -> StepResult:
        request: list[object] = ["reset", trial, track.value, actions, encoding.value, self._shared.next_place()]
        return await self._finished(self._ask(request, self._step_result, self._timeout_s + replay_s(actions)))

    @override
    async def step(self, action: Action, encoding: Encoding) -> StepResult:
        return await self._finished(self.begin_step(action, encoding))

    @override
    def begin_step(self, action: Action, encoding: Encoding) -> "asyncio.Future[StepResult]":
        request = ["step", *action, encoding.value, self._shared.next_place()]
        return self._ask(request, self._step_result, self._step_s)

    @override
    async def abort(self) -> EpisodeEnd:
        return await self._finished(self._ask(["abort"], lambda reply: _episode_end(reply[1]), self._timeout_s))

    @override
    async def view(self) -> bytes:
        return await self._finished(self._ask(["view"], lambda reply: bytes(reply[1]), self._timeout_s))

    async def prepare(self, town: str) -> None:
        """Load a town, so that its first reset is as quick as any other. Raises SimulatorDiedError."""
        await self._finished(self._ask(["prepare", town], lambda _: None, self._timeout_s))
        self.town = town

    def kill(self) -> None:
        """End the process at once; an awaited reply fails."""
        self._connection.closed = True
        self._transport.abort()
        self.process.kill()
        if self._alarm is not None:
            self._alarm.cancel()
            self._alarm = None

    async def close(self) -> None:
        """End the process and wait until it has ended."""
        self.kill()
        await asyncio.to_thread(self.process.wait)

    def _ask(
        self, request: Sequence[object], read: Callable[[list[Any]], _T], timeout_s: float
    ) -> "asyncio.Future[_T]":
        """Send a request, and return its reply."""
        if not self.dead:
            frames.write_now(self._transport, self._stream.fileno(), [frames.pack(request)])
        return self._expect(lambda reply: read(self._checked(reply)), timeout_s)

    def _checked(self, reply: list[Any]) -> list[Any]:
        """Return a reply to a request that worked. Raises EpisodeRefusedError, SimulatorDiedError."""
        if reply[0] == frames.REFUSED:
            raise EpisodeRefusedError(reply[1], reply[2])
        if reply[0] != frames.OK:
            # Its state is unknown, and the next episode must not inherit it.
            self.kill()
            raise SimulatorDiedError(f"{reply[1]}: {reply[2]}")
        return reply

    def _expect(self, read: Callable[[list[Any]], _T], timeout_s: float) -> "asyncio.Future[_T]":
        reply: asyncio.Future[_T] = self._loop.create_future()
        self._connection.expect(reply, read)
        self._set_deadline(timeout_s)
        return reply

    async def _finished(self, reply: "asyncio.Future[_T]") -> _T:
        try:
            return await reply
        except asyncio.CancelledError:
            # This reply would be taken for that to the next request.
            self.kill()
            raise

    def _set_deadline(self, timeout_s: float) -> None:
        self._limit_s, self._deadline = timeout_s, self._loop.time() + timeout_s
        self._set_alarm()

    def _set_alarm(self) -> None:
        """Call :meth:`_look` at the deadline. An earlier alarm stays: moving it takes time each step."""
        if self._alarm is not None:
            if self._alarm.when() <= self._deadline:
                return
            self._alarm.cancel()
        self._alarm = self._loop.call_at(self._deadline, self._look)

    def _look(self) -> None:
        self._alarm = None
        if self._connection.awaited is None:
            return
        if self._loop.time() < self._deadline:
            self._set_alarm()
            return
        self._connection.fail(f"the simulator process did not answer within {self._limit_s:g} s")
        self.kill()

    def _step_result(self, reply: list[Any]) -> StepResult:
        _, observation, reward, terminated, truncated, final = reply
        if isinstance(observation, int):
            observation = self._shared.view(observation)
        return StepResult(observation, reward, terminated, truncated, None if final is None else _episode_end(final))


def _episode_end(values: list[Any]) -> EpisodeEnd:
    outcome, steps, trajectory, trajectory_sha256, actions_sha256 = values
    return EpisodeEnd(Outcome.model_validate_json(outcome), steps, trajectory, trajectory_sha256, actions_sha256)
