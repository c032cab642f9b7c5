"""A pool of simulator processes on this machine. Each runs one libsumo; the web process runs none."""

import asyncio
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import structlog
from typing_extensions import override

from wrongturn_service.machine import Machine
from wrongturn_service.simulators.interface import (
    Simulator,
    SimulatorDiedError,
    SimulatorPool,
    SimulatorsBusyError,
    SimulatorStartError,
)
from wrongturn_service.simulators.local_simulator import LocalSimulator
from wrongturn_service.simulators.memory import memory_of

COMMAND = (sys.executable, "-m", "wrongturn_service.simulators.worker")
"""Command of a simulator process; :meth:`LocalSimulator.start` adds its arguments."""

START_WAIT_S: Final = 20.0
"""Seconds that a call waits for a simulator to start, before it is asked to come back."""


class LocalPool(SimulatorPool):
    """At most ``slots`` processes that drive; each is started when it is needed, and then kept."""

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
        """Create a pool without processes.

        Args:
            slots: number of processes that can drive at a time.
            start_timeout_s: seconds until a new process has to be ready.
            timeout_s: seconds after which a call counts as hung.
            spare: number of ready processes beyond those that drive, so that one that dies is replaced at once.
            environment: variables of the processes, beside the few that they get of this process's.
            command: starts a process.
            on_death: called for each process that is found dead.
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
        self._reserved = 0
        self._starting: set[asyncio.Task[None]] = set()
        # A start takes a core for seconds. More starts than cores would all be late.
        self._starts = asyncio.Semaphore(Machine().processors())
        self._waiting: list[asyncio.Future[None]] = []
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
        return len(self._idle) + len(self._busy) + len(self._starting)

    @property
    @override
    def busy(self) -> int:
        return len(self._busy) + self._reserved

    @property
    @override
    def idle(self) -> int:
        return len(self._idle)

    @property
    @override
    def failure(self) -> str | None:
        return self._failure

    @override
    def memory(self) -> int:
        return sum(memory_of(simulator.process.pid) for simulator in [*self._idle, *self._busy])

    @override
    async def start(self) -> None:
        self._idle.append(await self._started())

    @override
    async def stop(self) -> None:
        self._stopping = True
        for task in self._starting:
            task.cancel()
        await asyncio.gather(*self._starting, return_exceptions=True)
        await asyncio.gather(*(simulator.close() for simulator in [*self._idle, *self._busy]))
        self._idle.clear()

    @override
    async def acquire(self, town: str) -> LocalSimulator:
        # Remove all of them before the first await, so that no other call closes them too.
        dead = [simulator for simulator in self._idle if simulator.dead]
        self._idle = [simulator for simulator in self._idle if not simulator.dead]
        for simulator in dead:
            await self._close_dead(simulator)
        if self.busy >= self._slots:
            raise SimulatorsBusyError(f"all {self._slots} simulators are busy")
        simulator = await self._reserve(town)
        simulator.town = self._town = town
        self._busy.add(simulator)
        self._start_spare()
        return simulator

    async def _reserve(self, town: str) -> LocalSimulator:
        """Reserve a slot, and return the first simulator that is ready.

        Raises:
            SimulatorStartError: a simulator that was started meanwhile did not get ready.
            SimulatorsBusyError: none is ready in time; the start goes on.
        """
        loop = asyncio.get_running_loop()
        deadline = loop.time() + START_WAIT_S
        self._reserved += 1
        try:
            while True:
                simulator = self._take_idle(town)
                if simulator is not None:
                    return simulator
                if len(self._starting) < self._reserved and self.running < self._slots + self._spare:
                    self._begin_start(spare=False)
                waiter: asyncio.Future[None] = loop.create_future()
                self._waiting.append(waiter)
                try:
                    await asyncio.wait_for(waiter, deadline - loop.time())
                except TimeoutError:
                    raise SimulatorsBusyError(
                        f"{self._reserved} calls wait for simulators that are being started", self._reserved
                    ) from None
        except BaseException:
            self._wake()  # another call may have the slot
            raise
        finally:
            self._reserved -= 1

    @override
    async def release(self, simulator: Simulator) -> None:
        assert isinstance(simulator, LocalSimulator)
        if simulator not in self._busy:
            return
        self._busy.discard(simulator)
        if simulator.dead:
            await self._close_dead(simulator)
        else:
            self._idle.append(simulator)
        self._wake()

    def _wake(self, error: SimulatorStartError | None = None) -> None:
        """Let all waiting calls look again; one of them fails if a start failed."""
        waiting = [waiter for waiter in self._waiting if not waiter.done()]
        self._waiting = []
        if error is not None and waiting:
            waiting.pop(0).set_exception(error)
        for waiter in waiting:
            waiter.set_result(None)

    def _take_idle(self, town: str) -> LocalSimulator | None:
        alive = [simulator for simulator in self._idle if not simulator.dead]
        if not alive:
            return None
        # Prefer one that has the town loaded, then the one that was used last: its memory is still in the caches.
        loaded = [simulator for simulator in alive if simulator.town == town]
        simulator = (loaded or alive)[-1]
        self._idle.remove(simulator)
        return simulator

    def _start_spare(self) -> None:
        """Start missing spare processes in the background."""
        while (
            len(self._idle) + len(self._starting) - self._reserved < self._spare
            and self.running < self._slots + self._spare
            and not self._stopping
        ):
            self._begin_start(spare=True)

    def _begin_start(self, *, spare: bool) -> None:
        self._starting.add(asyncio.create_task(self._start_one(spare=spare)))

    async def _start_one(self, *, spare: bool) -> None:
        simulator, failed = None, None
        try:
            simulator = await self._started()
            if spare:
                await simulator.prepare(self._town)
        except SimulatorStartError as error:
            failed = error
            self._log.warning("simulator did not start", reason=str(error))
        except SimulatorDiedError as error:
            self._log.warning("spare simulator did not get ready", reason=str(error))
        finally:
            self._starting = {task for task in self._starting if task is not asyncio.current_task()}
            if simulator is not None:
                self._idle.append(simulator)
            self._wake(failed)

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

    async def _close_dead(self, simulator: LocalSimulator) -> None:
        await simulator.close()
        if not self._stopping:
            self._on_death()
            self._log.warning("simulator died", pid=simulator.process.pid, status=simulator.process.returncode)
