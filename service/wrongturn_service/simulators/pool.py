"""A pool of simulator processes. Each runs one libsumo; the web process runs none."""

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Final

import structlog

from wrongturn_service.simulators.interface import (
    Place,
    SimulatorDiedError,
    SimulatorsBusyError,
    SimulatorStartError,
    in_turn,
)
from wrongturn_service.simulators.simulator import Simulator

START_WAIT_S: Final = 20.0
"""Seconds that a call waits for a simulator to start, before it is asked to come back."""
PAUSE_S: Final = 30.0
"""Seconds without new spares after an idle one has died. If memory has run out, a new one dies too."""


@dataclass(slots=True, eq=False)
class _Waiting:
    """An agent's call that waits for a simulator."""

    agent: str
    town: Place
    simulator: "asyncio.Future[Simulator]"


class SimulatorPool:
    """At most ``slots`` processes that drive; each is started when it is needed, and then kept."""

    def __init__(
        self,
        slots: int,
        start: Callable[[], Awaitable[Simulator]],
        *,
        spare: int = 0,
        on_death: Callable[[], None] = lambda: None,
    ) -> None:
        """Create a pool without processes. ``start`` starts one or raises SimulatorStartError.

        ``spare`` processes beyond those that drive are kept ready, so that one that dies is replaced at once.
        ``on_death`` is called for each process that is found dead.
        """
        self.slots = slots
        """Number of simulators that can drive at a time."""
        self.failure: str | None = None
        """Why the last start of a simulator failed; None if it did not."""
        self._spare = spare
        self._begin = start
        self._on_death = on_death
        self._idle: list[Simulator] = []
        self._busy: dict[Simulator, str] = {}
        self._starting: set[asyncio.Task[None]] = set()
        self._waiting: list[_Waiting] = []
        self._paused = False
        self._town: Place = ("", None)
        self._stopping = False
        self._log = structlog.get_logger("pool")

    @property
    def running(self) -> int:
        """Number of simulators that are started or being started."""
        return len(self._idle) + len(self._busy) + len(self._starting)

    @property
    def busy(self) -> int:
        """Number of simulators that are acquired or waited for."""
        return len(self._busy) + len(self._waiting)

    @property
    def idle(self) -> int:
        """Number of simulators that are ready and not acquired."""
        return len(self._idle)

    def memory(self) -> int:
        """Return the memory of all simulators, bytes, what they share counted once. Takes a while."""
        return sum(simulator.memory() for simulator in [*self._idle, *self._busy])

    def resize(self, slots: int) -> None:
        """Let another number of simulators drive. Those that drive go on, even if they are more."""
        self.slots = slots
        if not self._stopping:
            self._hand_out()

    async def start(self) -> None:
        """Make a first simulator ready. Raises SimulatorStartError."""
        self._idle.append(await self._started())

    async def stop(self) -> None:
        """End all simulators."""
        self._stopping = True
        for task in self._starting:
            task.cancel()
        await asyncio.gather(*self._starting, return_exceptions=True)
        await asyncio.gather(*(simulator.close() for simulator in [*self._idle, *self._busy]))
        self._idle.clear()

    async def acquire(self, town: Place, agent: str) -> Simulator:
        """Return a simulator for the caller alone, preferably one that has the town loaded.

        Of two calls that wait for a start, that of the agent with fewer simulators comes first.

        Raises:
            SimulatorsBusyError: Every slot is taken, or no simulator got ready in time.
            SimulatorStartError: No simulator could be started.
        """
        # Remove all of them before the first await, so that no other call closes them too.
        dead = [simulator for simulator in self._idle if simulator.dead]
        self._idle = [simulator for simulator in self._idle if not simulator.dead]
        if dead:
            self._pause()
        for simulator in dead:
            await self._close_dead(simulator)
        if self.busy >= self.slots:
            raise SimulatorsBusyError(f"all {self.slots} simulators are busy")
        waiting = _Waiting(agent, town, asyncio.get_running_loop().create_future())
        self._waiting.append(waiting)
        self._hand_out()
        try:
            ready, _ = await asyncio.wait([waiting.simulator], timeout=START_WAIT_S)
        except asyncio.CancelledError:
            if waiting in self._waiting:
                self._waiting.remove(waiting)
            elif waiting.simulator.exception() is None:
                await self.release(waiting.simulator.result())
            raise
        if not ready:
            count, position = len(self._waiting), self._line().index(waiting) + 1
            self._waiting.remove(waiting)
            raise SimulatorsBusyError(f"{count} calls wait for simulators that are being started", position)
        simulator = waiting.simulator.result()
        self._town = town
        self._start_spare()
        return simulator

    def _line(self) -> list[_Waiting]:
        """Return the waiting calls, the next one first."""
        return in_turn(Counter(self._busy.values()), (((waiting.agent,), waiting) for waiting in self._waiting))

    async def release(self, simulator: Simulator) -> None:
        """Take a simulator back, dead or alive."""
        if simulator not in self._busy:
            return
        del self._busy[simulator]
        if simulator.dead:
            await self._close_dead(simulator)
        else:
            self._idle.append(simulator)
        self._hand_out()

    def _hand_out(self) -> None:
        """Give ready simulators to waiting calls, and start what is missing for the others."""
        while self._waiting and (ready := [simulator for simulator in self._idle if not simulator.dead]):
            waiting = self._line()[0]
            # Prefer one that has the town loaded, then the one that was used last: its memory is still in the caches.
            simulator = max(ready, key=lambda one: (one.town == waiting.town, ready.index(one)))
            self._idle.remove(simulator)
            self._waiting.remove(waiting)
            simulator.town = waiting.town
            self._busy[simulator] = waiting.agent
            waiting.simulator.set_result(simulator)
        while len(self._starting) < len(self._waiting) and self.running < self.slots + self._spare:
            self._begin_start(spare=False)

    def _start_spare(self) -> None:
        """Start missing spare processes in the background."""
        while (
            len(self._idle) + len(self._starting) - len(self._waiting) < self._spare
            and self.running < self.slots + self._spare
            and not self._stopping
            and not self._paused
        ):
            self._begin_start(spare=True)

    def _pause(self) -> None:
        """Start no spare processes for a while."""
        if not self._paused:
            self._paused = True
            asyncio.get_running_loop().call_later(PAUSE_S, self._resume)

    def _resume(self) -> None:
        self._paused = False
        self._start_spare()

    def _begin_start(self, *, spare: bool) -> None:
        self._starting.add(asyncio.create_task(self._start_one(spare=spare)))

    async def _start_one(self, *, spare: bool) -> None:
        simulator = None
        try:
            simulator = await self._started()
            if spare:
                await simulator.prepare(self._town)
        except SimulatorStartError as error:
            self._pause()
            self._log.warning("simulator did not start", reason=str(error))
            if self._waiting:
                self._waiting.pop(0).simulator.set_exception(error)
        except SimulatorDiedError as error:
            self._log.warning("spare simulator did not get ready", reason=str(error))
        finally:
            self._starting = {task for task in self._starting if task is not asyncio.current_task()}
            if simulator is not None:
                self._idle.append(simulator)
            if not self._stopping:
                self._hand_out()

    async def _started(self) -> Simulator:
        if self._stopping:
            raise SimulatorStartError("the service is stopping")
        try:
            simulator = await self._begin()
        except SimulatorStartError as error:
            self.failure = str(error)
            raise
        self.failure = None
        self._log.info("simulator started", process=simulator.name)
        return simulator

    async def _close_dead(self, simulator: Simulator) -> None:
        await simulator.close()
        if not self._stopping:
            self._on_death()
            self._log.warning("simulator died", process=simulator.name)
