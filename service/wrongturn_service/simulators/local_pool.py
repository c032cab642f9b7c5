"""Simulators as processes of this machine: one libsumo each, none in the web process."""

import asyncio
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import structlog
from typing_extensions import override

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
"""What is started for each simulator; the socket's descriptor, the time limit and the screen's are added."""

START_WAIT_S: Final = 20.0
"""Seconds for which a call waits for a simulator to be started, before it is told to come back."""


class LocalPool(SimulatorPool):
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
        self._promises = 0
        self._warming: set[asyncio.Task[None]] = set()
        # Each start takes a core for seconds: more at a time would make all of them late.
        self._starts = asyncio.Semaphore(os.cpu_count() or 1)
        self._hopeful: list[asyncio.Future[None]] = []
        self._waiters: list[asyncio.Future[None]] = []
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
        return len(self._idle) + len(self._busy) + len(self._warming)

    @property
    @override
    def busy(self) -> int:
        return len(self._busy) + self._promises

    @property
    @override
    def idle(self) -> int:
        return len(self._idle)

    @property
    @override
    def waiting(self) -> int:
        return sum(not waiter.done() for waiter in [*self._hopeful, *self._waiters])

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
                await self._close_dead(simulator)
            if self.busy < self._slots:
                found = await self._promised(town)
                found.town = self._town = town
                self._busy.add(found)
                self._warm_up()
                return found
            if not wait:
                raise SimulatorsBusyError(f"all {self._slots} simulators are busy")
            waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            self._waiters.append(waiter)
            await waiter

    async def _promised(self, town: str) -> LocalSimulator:
        """One for who has a place: the first that is free or ready, whoever it was started for.

        Raises:
            SimulatorStartError: one that was started for those who wait did not get ready.
            SimulatorsBusyError: none is ready in time; it is started all the same.
        """
        loop = asyncio.get_running_loop()
        deadline = loop.time() + START_WAIT_S
        self._promises += 1
        try:
            while True:
                found = self._take(town)
                if found is not None:
                    return found
                if len(self._warming) < self._promises and self.running < self._slots + self._spare:
                    self._begin_start(spare=False)
                waiter: asyncio.Future[None] = loop.create_future()
                self._hopeful.append(waiter)
                try:
                    await asyncio.wait_for(waiter, deadline - loop.time())
                except TimeoutError:
                    raise SimulatorsBusyError(
                        f"{self._promises} calls wait for simulators that are being started", self._promises
                    ) from None
        except BaseException:
            self._wake()  # the place is another's
            raise
        finally:
            self._promises -= 1

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
        """Let all who wait look again; where a start failed, one of them hears of it."""
        hopeful, self._hopeful = self._hopeful, []
        waiting, self._waiters = self._waiters, []
        for waiter in [*hopeful, *waiting]:
            if waiter.done():
                continue
            if error is not None and waiter in hopeful:
                waiter.set_exception(error)
                error = None
            else:
                waiter.set_result(None)

    def _take(self, town: str) -> LocalSimulator | None:
        alive = [simulator for simulator in self._idle if not simulator.dead]
        if not alive:
            return None
        # The town it has need not be loaded again; of those, the one that was used last is warmest.
        fitting = [simulator for simulator in alive if simulator.town == town]
        simulator = (fitting or alive)[-1]
        self._idle.remove(simulator)
        return simulator

    def _warm_up(self) -> None:
        """Start what is lacking of the spare ones, in the background."""
        while (
            len(self._idle) + len(self._warming) - self._promises < self._spare
            and self.running < self._slots + self._spare
            and not self._stopping
        ):
            self._begin_start(spare=True)

    def _begin_start(self, *, spare: bool) -> None:
        self._warming.add(asyncio.create_task(self._start_one(spare=spare)))

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
            self._warming = {task for task in self._warming if task is not asyncio.current_task()}
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
