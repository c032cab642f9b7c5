"""Simulators as processes of this machine: one libsumo each, none in the web process."""

import asyncio
import os
import sys
from collections import deque
from collections.abc import Callable, Mapping, Sequence

import structlog
from typing_extensions import override

from wrongturn_service.pool.local_simulator import LocalSimulator
from wrongturn_service.pool.memory import memory_of
from wrongturn_service.pool.pool import (
    Pool,
    Simulator,
    SimulatorDiedError,
    SimulatorsBusyError,
    SimulatorStartError,
)

COMMAND = (sys.executable, "-m", "wrongturn_service.pool.process")
"""What is started for each simulator; the socket's descriptor, the time limit and the screen's are added."""


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
        self._town = ""
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
                found.town = self._town = town
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
            await simulator.prepare(self._town)
        except (SimulatorStartError, SimulatorDiedError) as error:
            self._log.warning("spare simulator did not start", reason=str(error))
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
