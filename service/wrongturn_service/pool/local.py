"""Simulators as processes of this machine: one libsumo each, none in the web process."""

import asyncio
import os
import socket
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import structlog
from typing_extensions import override

from wrongturn_protocol import Outcome, Track
from wrongturn_service.pool import frames
from wrongturn_service.pool.memory import memory_of
from wrongturn_service.pool.pool import (
    Action,
    EpisodeRefusedError,
    Final,
    Frame,
    Pool,
    Simulator,
    SimulatorDiedError,
    SimulatorsBusyError,
    SimulatorStartError,
    replay_s,
)
from wrongturn_service.wire import Wire

COMMAND = (sys.executable, "-m", "wrongturn_service.pool.process")
"""What is started for each simulator; the socket's descriptor and the time limit are added."""


class _Line(asyncio.Protocol):
    """The stream to a process: one request out, one reply in."""

    def __init__(self) -> None:
        self.closed = False
        self.waiting: asyncio.Future[list[Any]] | None = None
        self._splitter = frames.Splitter()

    def data_received(self, data: bytes) -> None:
        for value in self._splitter.feed(data):
            if self.waiting is not None and not self.waiting.done():
                self.waiting.set_result(value)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002
        self.closed = True
        if self.waiting is not None and not self.waiting.done():
            self.waiting.set_exception(SimulatorDiedError("the simulator process ended"))


class LocalSimulator(Simulator):
    """One process; use :meth:`start`."""

    def __init__(
        self,
        process: subprocess.Popen[bytes],
        transport: asyncio.Transport,
        line: _Line,
        timeout_s: float,
    ) -> None:
        self.process = process
        self.town = ""
        """What it has loaded."""
        self._transport = transport
        self._line = line
        self._timeout_s = timeout_s
        self._loop = asyncio.get_running_loop()

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
        with theirs:
            handle = theirs.fileno()

            def spawn() -> subprocess.Popen[bytes]:
                return subprocess.Popen(  # noqa: S603 - our own program
                    [*command, str(handle), str(int(timeout_s) + 1)],
                    pass_fds=[handle],
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
        transport, line = await asyncio.get_running_loop().create_unix_connection(_Line, sock=ours)
        simulator = cls(process, transport, line, timeout_s)
        try:
            await simulator._receive(start_timeout_s)
        except SimulatorDiedError as error:
            await simulator.close()
            status = process.returncode
            raise SimulatorStartError(
                f"a simulator process did not get ready ({error}, status {status}); what it said is on stderr, "
                "and 'wrongturn doctor' checks the installation",
            ) from error
        except BaseException:
            simulator.kill()
            raise
        return simulator

    @property
    @override
    def dead(self) -> bool:
        return self._line.closed

    @override
    async def reset(self, trial: str, track: Track, actions: bytes, wire: Wire) -> Frame:
        request: list[object] = ["reset", trial, track.value, actions, wire.value]
        return _frame(await self._call(request, self._timeout_s + replay_s(actions)))

    @override
    async def step(self, action: Action, wire: Wire) -> Frame:
        return _frame(await self._call(["step", *action, wire.value]))

    @override
    async def abort(self) -> Final:
        return _final((await self._call(["abort"]))[1])

    def kill(self) -> None:
        """End it at once; whoever waits for it hears of it."""
        self._line.closed = True
        self._transport.abort()
        self.process.kill()

    async def close(self) -> None:
        """End it and wait until it is gone."""
        self.kill()
        await asyncio.to_thread(self.process.wait)

    async def _call(self, request: list[object], timeout_s: float | None = None) -> list[Any]:
        if self.dead:
            raise SimulatorDiedError("the simulator process ended")
        self._transport.write(frames.pack(request))
        reply = await self._receive(timeout_s or self._timeout_s)
        if reply[0] == frames.REFUSED:
            raise EpisodeRefusedError(reply[1], reply[2])
        if reply[0] != frames.OK:
            # What state it is in nobody knows: the next episode must not inherit it.
            self.kill()
            raise SimulatorDiedError(f"{reply[1]}: {reply[2]}")
        return reply

    async def _receive(self, timeout_s: float) -> list[Any]:
        line = self._line
        waiting: asyncio.Future[list[Any]] = self._loop.create_future()
        line.waiting = waiting
        if line.closed:
            line.waiting = None
            raise SimulatorDiedError("the simulator process ended")
        alarm = self._loop.call_later(timeout_s, self._expire, waiting, timeout_s)
        try:
            return await waiting
        except asyncio.CancelledError:
            # Its reply would be taken for the next request's.
            self.kill()
            raise
        finally:
            alarm.cancel()
            line.waiting = None

    def _expire(self, waiting: "asyncio.Future[list[Any]]", timeout_s: float) -> None:
        if not waiting.done():
            waiting.set_exception(SimulatorDiedError(f"the simulator process did not answer within {timeout_s:g} s"))
        self.kill()


class LocalPool(Pool):
    """Processes of this machine, at most ``slots``; each is started when needed and then kept."""

    def __init__(
        self,
        slots: int,
        *,
        start_timeout_s: float,
        timeout_s: float,
        spare: int = 0,
        environment: Mapping[str, str] | None = None,
        command: Sequence[str] = COMMAND,
        on_death: Callable[[], None] = lambda: None,
    ) -> None:
        """Describe the pool; nothing is started yet.

        Args:
            slots: processes that drive at most.
            start_timeout_s: seconds in which one must be ready.
            timeout_s: seconds after which one that does not answer counts as dead.
            spare: processes kept warm beyond those that drive, so that one that dies is replaced at once.
            environment: added to this process's for them.
            command: what is started for each.
            on_death: called for each that is found dead.
        """
        self._slots = slots
        self._spare = spare
        self._start_timeout_s = start_timeout_s
        self._timeout_s = timeout_s
        self._environment = {"OMP_NUM_THREADS": "1", **(environment or {})}
        self._command = tuple(command)
        self._on_death = on_death
        self._idle: list[LocalSimulator] = []
        self._busy: set[LocalSimulator] = set()
        self._starting = 0
        self._warming: set[asyncio.Task[None]] = set()
        # Each start takes a core for seconds: more at a time would make all of them late.
        self._starts = asyncio.Semaphore(os.cpu_count() or 1)
        self._waiters: deque[asyncio.Future[None]] = deque()
        self._stopping = False
        self._failure: str | None = None
        self._log = structlog.get_logger("pool")

    @property
    @override
    def slots(self) -> int:
        return self._slots

    @property
    @override
    def running(self) -> int:
        return len(self._idle) + len(self._busy) + self._starting + len(self._warming)

    @property
    @override
    def busy(self) -> int:
        return len(self._busy) + self._starting

    @property
    @override
    def idle(self) -> int:
        return len(self._idle)

    @property
    @override
    def waiting(self) -> int:
        return sum(not waiter.done() for waiter in self._waiters)

    @property
    @override
    def failure(self) -> str | None:
        return self._failure

    @override
    def memory(self) -> int:
        return sum(memory_of(simulator.process.pid) for simulator in [*self._idle, *self._busy])

    @override
    async def start(self) -> None:
        self._idle.append(await self._start())

    @override
    async def stop(self) -> None:
        self._stopping = True
        for task in self._warming:
            task.cancel()
        await asyncio.gather(*self._warming, return_exceptions=True)
        await asyncio.gather(*(simulator.close() for simulator in [*self._idle, *self._busy]))
        self._idle.clear()

    @override
    async def acquire(self, town: str, *, wait: bool = False) -> LocalSimulator:
        while True:
            # All leave the list before anything is awaited: whoever else looks meanwhile must not find them again.
            dead = [simulator for simulator in self._idle if simulator.dead]
            self._idle = [simulator for simulator in self._idle if not simulator.dead]
            for simulator in dead:
                await self._bury(simulator)
            placed = self.busy < self._slots
            found = self._take(town) if placed else None
            if found is None and placed and self.running < self._slots + self._spare:
                found = await self._start()
            if found is not None:
                found.town = town
                self._busy.add(found)
                self._warm_up()
                return found
            # Where there is a place and yet no simulator, the spare one is about to be ready.
            if not wait and not placed:
                raise SimulatorsBusyError(f"all {self._slots} simulators are busy")
            waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            self._waiters.append(waiter)
            await waiter

    @override
    async def release(self, simulator: Simulator) -> None:
        assert isinstance(simulator, LocalSimulator)
        if simulator not in self._busy:
            return
        self._busy.discard(simulator)
        if simulator.dead:
            await self._bury(simulator)
        else:
            self._idle.append(simulator)
        self._wake()

    def _wake(self) -> None:
        """Let one who waits look again: there is a place."""
        while self._waiters:
            waiter = self._waiters.popleft()
            if not waiter.done():
                waiter.set_result(None)
                break

    def _take(self, town: str) -> LocalSimulator | None:
        if not self._idle:
            return None
        # The town it has need not be loaded again; of those, the one that was used last is warmest.
        fitting = [simulator for simulator in self._idle if simulator.town == town]
        simulator = (fitting or self._idle)[-1]
        self._idle.remove(simulator)
        return simulator

    def _warm_up(self) -> None:
        """Start what is lacking of the spare ones, in the background."""
        while (
            len(self._idle) + len(self._warming) < self._spare
            and self.running < self._slots + self._spare
            and not self._stopping
        ):
            self._warming.add(asyncio.create_task(self._start_spare()))

    async def _start_spare(self) -> None:
        simulator = None
        try:
            simulator = await self._started()
        except SimulatorStartError as error:
            self._log.warning("simulator did not start", reason=str(error))
        finally:
            self._warming = {task for task in self._warming if task is not asyncio.current_task()}
            if simulator is not None:
                self._idle.append(simulator)
            self._wake()

    async def _start(self) -> LocalSimulator:
        self._starting += 1
        try:
            return await self._started()
        except BaseException:
            self._wake()
            raise
        finally:
            self._starting -= 1

    async def _started(self) -> LocalSimulator:
        if self._stopping:
            raise SimulatorStartError("the service is stopping")
        try:
            async with self._starts:
                simulator = await LocalSimulator.start(
                    self._command,
                    self._environment,
                    start_timeout_s=self._start_timeout_s,
                    timeout_s=self._timeout_s,
                )
        except SimulatorStartError as error:
            self._failure = str(error)
            raise
        self._failure = None
        self._log.info("simulator started", pid=simulator.process.pid)
        return simulator

    async def _bury(self, simulator: LocalSimulator) -> None:
        await simulator.close()
        if not self._stopping:
            self._on_death()
            self._log.warning("simulator died", pid=simulator.process.pid, status=simulator.process.returncode)


def _frame(reply: list[Any]) -> Frame:
    _, observation, reward, terminated, truncated, final = reply
    return Frame(observation, reward, terminated, truncated, None if final is None else _final(final))


def _final(values: list[Any]) -> Final:
    outcome, steps, trajectory, trajectory_sha256, actions_sha256 = values
    return Final(Outcome.model_validate_json(outcome), steps, trajectory, trajectory_sha256, actions_sha256)
