"""Simulators that only count, so that failures and clocks can be played without SUMO."""

import asyncio
import hashlib
import struct

import numpy as np
import orjson
from typing_extensions import override

from wrongturn_protocol import JourneyOutcome, Outcome, Track, Verdict
from wrongturn_protocol.observations import FIELDS
from wrongturn_service.encoding import Encoding, encoded
from wrongturn_service.simulators.interface import (
    Action,
    EpisodeEnd,
    EpisodeRefusedError,
    SimulatorDiedError,
    SimulatorsBusyError,
    SimulatorStartError,
    StepResult,
)
from wrongturn_service.simulators.pool import SimulatorPool
from wrongturn_service.simulators.simulator import Simulator


class FakeSimulator(Simulator):
    """Its observed speed is the number of actions, and after ten of them it is over: an exit, or a journey's end."""

    def __init__(self, pool: "FakePool") -> None:
        self._pool = pool
        self._trial = ""
        self._track = Track.STATE
        self.is_dead = False
        self.actions = b""

    @property
    @override
    def dead(self) -> bool:
        return self.is_dead

    @override
    async def reset(self, trial: str, track: Track, actions: bytes, encoding: Encoding) -> StepResult:
        if self._pool.refuse:
            raise EpisodeRefusedError("FaultNotApplicableError", "fault: not here")
        if actions:
            self._pool.replays += 1
        self._fail(self._pool.deaths_at_reset)
        self.actions = actions
        self._trial = trial
        self._track = track
        return self._frame(encoding)

    @override
    def step(self, action: Action, encoding: Encoding) -> "asyncio.Future[StepResult]":
        return asyncio.ensure_future(self._step(action, encoding))

    async def _step(self, action: Action, encoding: Encoding) -> StepResult:
        await asyncio.sleep(0)
        self._fail(self._pool.deaths_at_step)
        self.actions += struct.pack("<3f", *action)
        return self._frame(encoding)

    @override
    async def view(self) -> bytes:
        self._fail(self._pool.deaths_at_step)
        return b"P6\n1 1\n255\n" + bytes([len(self.actions) // 12] * 3)

    @override
    async def abort(self) -> EpisodeEnd:
        self._fail(self._pool.deaths_at_abort)
        return self._final(Verdict.ABORTED)

    def _fail(self, deaths: list[None]) -> None:
        if deaths and not self.is_dead:
            deaths.pop()
            self.is_dead = True
        if self.is_dead:
            raise SimulatorDiedError("played")

    def _frame(self, encoding: Encoding) -> StepResult:
        steps = len(self.actions) // 12
        shown = {field.name: np.zeros(field.shape, field.numpy_dtype) for field in FIELDS[self._track]}
        shown["speed"][0] = steps + self._pool.drift
        shown["command"][0] = 4
        observation = encoded(shown, self._track, encoding)
        over = steps == self._pool.steps
        end = self._pool.ends.get(self._trial_id, Verdict.ARRIVED if self._journey else self._pool.end)
        return StepResult(observation, 1.0, over, False, self._final(end) if over else None)

    @property
    def _trial_id(self) -> str:
        found: str = orjson.loads(self._trial)["id"]
        return found

    @property
    def _journey(self) -> bool:
        return "journey" in orjson.loads(self._trial)

    def _final(self, verdict: Verdict) -> EpisodeEnd:
        steps = len(self.actions) // 12
        trajectory = orjson.dumps({"steps": steps})
        journey = JourneyOutcome(distance=500, completion=1, junctions=2, off_road=0, wrong_lane=1, collisions=0)
        return EpisodeEnd(
            Outcome(verdict=verdict, time=steps / 10, max_deceleration=0.0, journey=journey if self._journey else None),
            steps,
            trajectory,
            hashlib.sha256(trajectory).hexdigest(),
            hashlib.sha256(self.actions).hexdigest(),
        )


class FakePool(SimulatorPool):
    """Fails as often as it is told to."""

    def __init__(self, slots: int = 4) -> None:
        self.slots = slots
        self.failure = None
        self.taken: set[Simulator] = set()
        self.most = 0
        self.replays = 0
        self.steps = 10
        """After which an episode is over."""
        self.end = Verdict.EXIT_COMMANDED
        """Of an episode that is driven to its end."""
        self.ends: dict[str, Verdict] = {}
        """By trial, where it is another."""
        self.refuse = False
        self.drift = 0.0
        self.starts = 0
        self.deaths_at_start: list[None] = []
        self.deaths_at_reset: list[None] = []
        self.deaths_at_step: list[None] = []
        self.deaths_at_abort: list[None] = []

    @override
    async def start(self) -> None:
        pass

    @override
    async def stop(self) -> None:
        pass

    @override
    async def acquire(self, town: tuple[str, int | None], agent: str) -> Simulator:
        if len(self.taken) >= self.slots:
            raise SimulatorsBusyError(f"all {self.slots} simulators are busy")
        self.starts += 1
        if self.deaths_at_start:
            self.deaths_at_start.pop()
            raise SimulatorStartError("played")
        simulator = FakeSimulator(self)
        self.taken.add(simulator)
        self.most = max(self.most, len(self.taken))
        return simulator

    @override
    async def release(self, simulator: Simulator) -> None:
        self.taken.discard(simulator)

    @property
    @override
    def running(self) -> int:
        return len(self.taken)

    @property
    @override
    def busy(self) -> int:
        return len(self.taken)

    @property
    @override
    def idle(self) -> int:
        return 0

    @override
    def memory(self) -> int:
        return 0
