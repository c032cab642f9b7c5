"""Who gets a simulator first while they are being started, and when spare ones are started again after deaths."""

import asyncio
import contextlib
import itertools
import selectors
from collections.abc import Awaitable, Callable

import pytest
from typing_extensions import override

from wrongturn_service.simulators import pool as pool_module
from wrongturn_service.simulators.interface import SimulatorsBusyError
from wrongturn_service.simulators.pool import PAUSE_S, SimulatorPool
from wrongturn_service.simulators.simulator import Simulator

START_S = 4.5


class JumpingSelector(selectors.DefaultSelector):
    """Waits for no timer: the time jumps there."""

    now = 0.0

    @override
    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        self.now += timeout or 0
        return super().select(0)


class JumpingLoop(asyncio.SelectorEventLoop):
    """An event loop without real time."""

    def __init__(self) -> None:
        self._times = JumpingSelector()
        super().__init__(self._times)

    @override
    def time(self) -> float:
        return self._times.now


class Played(Simulator):
    """A simulator without a process. It lives until the test kills it."""

    def __init__(self, stage: "Stage") -> None:
        self.town = ""
        self.killed = False
        self._stage = stage

    name = "played"

    @property
    @override
    def dead(self) -> bool:
        return self.killed

    @override
    async def prepare(self, town: str) -> None:
        self._stage.spares.append(asyncio.get_running_loop().time())

    @override
    async def close(self) -> None:
        self.killed = True


class Stage:
    """Simulators that start one after the other, each for :data:`START_S`."""

    def __init__(self) -> None:
        self.started: list[Played] = []
        self._one_at_a_time = asyncio.Lock()
        self.spares: list[float] = []
        """Seconds at which spare ones were ready."""

    async def start(self) -> Played:
        async with self._one_at_a_time:
            await asyncio.sleep(START_S)
        simulator = Played(self)
        self.started.append(simulator)
        return simulator


def play(stage: Stage, story: Callable[[SimulatorPool], Awaitable[None]], slots: int, spare: int = 0) -> None:
    async def played() -> None:
        pool = SimulatorPool(slots, stage.start, spare=spare)
        try:
            await story(pool)
        finally:
            await pool.stop()

    with asyncio.Runner(loop_factory=JumpingLoop) as runner:
        runner.run(played())


def test_a_rush_of_calls_does_not_keep_out_who_asks_for_one_while_simulators_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def story(pool: SimulatorPool) -> None:
        served: list[str] = []

        async def ask(agent: str) -> None:
            with contextlib.suppress(SimulatorsBusyError):
                await pool.acquire(("Town01", None), agent)
                served.append(agent)

        calls = [asyncio.create_task(ask("greedy")) for _ in range(12)]
        await asyncio.sleep(1)
        with monkeypatch.context() as patch:
            patch.setattr(pool_module, "START_WAIT_S", 0)
            with pytest.raises(SimulatorsBusyError) as told:
                await pool.acquire(("Town01", None), "modest")
            assert told.value.position == 2
        calls += [asyncio.create_task(ask("modest")) for _ in range(2)]
        await asyncio.gather(*calls)
        # All have waited for 20 s, and no more than four simulators were ready in that time.
        assert served == ["greedy", "modest", "greedy", "modest"]

    play(Stage(), story, slots=16)


def test_spare_ones_that_die_again_and_again_are_started_rarely() -> None:
    stage = Stage()

    async def story(pool: SimulatorPool) -> None:
        loop = asyncio.get_running_loop()
        while loop.time() < 10 * PAUSE_S:
            simulator = await pool.acquire(("Town01", None), "b")
            await asyncio.sleep(1)
            for other in stage.started:
                other.killed |= other is not simulator
            await pool.release(simulator)
        gaps = [after - before for before, after in itertools.pairwise(stage.spares)]
        assert gaps
        assert all(PAUSE_S <= gap < PAUSE_S + 3 * START_S for gap in gaps[1:])

    play(stage, story, slots=2, spare=1)
