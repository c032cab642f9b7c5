"""Drives open episodes in simulators. If a simulator dies, the episode is replayed in another one."""

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Final, TypeVar

import structlog

from wrongturn_protocol import FaultKind, Outcome, Reaction, Rig, Trial, Verdict
from wrongturn_protocol.vehicle import DECISION_S
from wrongturn_service.encoding import Encoding
from wrongturn_service.episodes.open_episode import OpenEpisode
from wrongturn_service.episodes.queue import SimulatorQueue
from wrongturn_service.errors import UnavailableError
from wrongturn_service.simulators.interface import (
    Action,
    EpisodeEnd,
    SimulatorDiedError,
    SimulatorStartError,
    StepResult,
)
from wrongturn_service.simulators.pool import SimulatorPool
from wrongturn_service.simulators.simulator import Simulator
from wrongturn_service.telemetry import Call, Telemetry

ATTEMPTS: Final = 3
"""Simulators that may die in one call, or fail to start, before the episode is given up."""
START_PATIENCE_S: Final = 20.0
"""Seconds after which a call stops trying to start simulators; its client would not wait longer."""
HOLD_S: Final = 1.1
"""Seconds for which a call is held that can soon take a simulator from others."""
_T = TypeVar("_T")


class ReplayFailedError(Exception):
    """The episode could not be replayed. The infrastructure failed, not the agent."""


def aborted_outcome(trial: Trial, time_s: float) -> Outcome:
    """Return the outcome of an episode that was aborted after ``time_s`` seconds, without a simulator."""
    reaction = None if trial.fault.kind is FaultKind.NONE else Reaction.OTHER
    return Outcome(verdict=Verdict.ABORTED, reaction=reaction, time=time_s, max_deceleration=0.0)


def aborted_end(episode: OpenEpisode) -> EpisodeEnd:
    """Return the end of an open episode that is aborted without a simulator. It has no trajectory."""
    step_s = 1 / episode.sight.rate if isinstance(episode.sight, Rig) else DECISION_S
    return EpisodeEnd(aborted_outcome(episode.trial, episode.seq * step_s), episode.seq, b"", "", "")


class EpisodeDriver:
    """Begins, steps and aborts episodes. Callers hold the episode's lock.

    Every call raises UnavailableError if the episode needs another simulator and other calls come first,
    SimulatorsBusyError, SimulatorStartError, and ReplayFailedError. The episode stays open, so it can be sent again.
    """

    def __init__(self, pool: SimulatorPool, queue: SimulatorQueue, telemetry: Telemetry) -> None:
        self._pool = pool
        self._queue = queue
        self._telemetry = telemetry
        self._log = structlog.get_logger("driver")
        self.make_room: Callable[[OpenEpisode, int], Awaitable[float | None]]
        """Takes up to so many idle simulators from others for an episode, and returns the seconds until it can take
        another one, or None. Its :class:`Episodes` sets it."""

    async def begin(self, episode: OpenEpisode, encoding: Encoding, call: str) -> StepResult:
        """Reset an episode. A ``call`` that is sent again keeps its place in the queue. Raises EpisodeRefusedError."""

        async def begun(_: Simulator, result: StepResult) -> StepResult:
            return result

        return await self._in_another(episode, call, "reset", encoding, begun)

    async def step(self, episode: OpenEpisode, action: Action, encoding: Encoding) -> StepResult:
        """Take one step."""
        return await self._call(episode, "step", lambda simulator: simulator.step(action, encoding))

    async def view(self, episode: OpenEpisode) -> bytes:
        """Return a picture of the episode's moment, as a pixmap."""
        return await self._call(episode, "view", lambda simulator: simulator.view())

    async def abort(self, episode: OpenEpisode) -> EpisodeEnd:
        """End an episode as ``aborted``. If every simulator fails, the end has no trajectory."""
        try:
            return await self._call(episode, "abort", lambda simulator: simulator.abort())
        except (ReplayFailedError, SimulatorStartError):
            return aborted_end(episode)

    async def detach(self, episode: OpenEpisode) -> None:
        """Release the episode's simulator and its place in the queue."""
        try:
            await self._release(episode)
        finally:
            if episode.placed:
                episode.placed = False
                self._queue.leave(episode.payer.names)

    def holds(self, episode: OpenEpisode) -> tuple[int, ...]:
        """Return how many simulators the episode's address, owner and agent hold."""
        return self._queue.holds(episode.payer.names)

    async def _release(self, episode: OpenEpisode) -> None:
        simulator, episode.simulator = episode.simulator, None
        if simulator is not None:
            await self._pool.release(simulator)

    async def _call(self, episode: OpenEpisode, kind: Call, ask: Callable[[Simulator], Awaitable[_T]]) -> _T:
        if episode.simulator is not None:
            try:
                return await self._timed(kind, ask(episode.simulator))
            except SimulatorDiedError as error:
                self._log.warning("simulator died in an episode", episode=episode.id, reason=str(error))
        await self._release(episode)

        async def replayed(simulator: Simulator, result: StepResult) -> _T:
            if result.observation != episode.last.observation:
                self._log.error("replay differs", episode=episode.id, seq=episode.seq)
                raise SimulatorDiedError("its observation differs")
            self._telemetry.replays.inc()
            return await self._timed(kind, ask(simulator))

        return await self._in_another(episode, episode.id, "replay", episode.last.encoding, replayed)

    async def _in_another(
        self,
        episode: OpenEpisode,
        place: str,
        kind: Call,
        encoding: Encoding,
        go_on: Callable[[Simulator, StepResult], Awaitable[_T]],
    ) -> _T:
        """Begin or replay the episode in another simulator, and go on there.

        An episode whose simulator died keeps its place in the queue, so that no other call gets in between.
        """
        if not episode.placed:
            await self._claim(episode, place)
            episode.placed = True
        trial, actions = episode.trial.model_dump_json(), bytes(episode.actions)
        try:
            async for simulator in self._simulators(episode):
                episode.simulator = simulator
                try:
                    return await go_on(
                        simulator, await self._timed(kind, simulator.reset(trial, episode.sight, actions, encoding))
                    )
                except SimulatorDiedError as error:
                    self._log.warning(f"{kind} failed", episode=episode.id, seq=episode.seq, reason=str(error))
                    await self._release(episode)
            verb = "begin" if kind == "reset" else kind
            raise ReplayFailedError(f"{ATTEMPTS} simulators failed to {verb} the episode")
        except BaseException:
            await self.detach(episode)
            raise

    async def _claim(self, episode: OpenEpisode, place: str) -> None:
        """Claim a simulator, for which the call at the front of the queue waits up to a second. Raises as ``enter``."""
        names, until = episode.payer.names, time.monotonic() + HOLD_S
        while True:
            wait_s = None
            if position := self._queue.position(names, place):
                wait_s = await self.make_room(episode, position)
            try:
                self._queue.enter(names, place)
                return
            except UnavailableError as error:
                if error.position != 1 or wait_s is None or time.monotonic() + wait_s > until:
                    raise
                await asyncio.sleep(max(wait_s, 0.01))

    async def _simulators(self, episode: OpenEpisode) -> AsyncIterator[Simulator]:
        """Yield up to :data:`ATTEMPTS` simulators. One that does not start counts as an attempt.

        Raises:
            SimulatorsBusyError.
            SimulatorStartError: The last one did not start.
        """
        began = time.monotonic()
        for attempt in range(1, ATTEMPTS + 1):
            try:
                simulator = await self._pool.acquire((episode.trial.town, episode.trial.scenery), episode.holder)
            except SimulatorStartError as error:
                if attempt == ATTEMPTS or time.monotonic() - began > START_PATIENCE_S:
                    raise
                self._log.warning("simulator did not start", reason=str(error))
            else:
                yield simulator

    async def _timed(self, call: Call, answer: Awaitable[_T]) -> _T:
        began = time.perf_counter()
        try:
            return await answer
        finally:
            self._telemetry.simulated(call, time.perf_counter() - began)
