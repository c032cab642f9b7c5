"""Drives open episodes in simulators. If a simulator dies, the episode is replayed in another one."""

import time
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Final, TypeVar

import structlog

from wrongturn_protocol import FaultKind, Outcome, Reaction, Trial, Verdict
from wrongturn_service.encoding import Encoding
from wrongturn_service.episodes.open_episode import OpenEpisode
from wrongturn_service.episodes.queue import SimulatorQueue
from wrongturn_service.simulators.actions import Action
from wrongturn_service.simulators.interface import (
    EpisodeEnd,
    Simulator,
    SimulatorDiedError,
    SimulatorPool,
    SimulatorStartError,
    StepResult,
)
from wrongturn_service.telemetry import Call

ATTEMPTS: Final = 3
"""Simulators that may die in one call, or fail to start, before the episode is given up."""
START_PATIENCE_S: Final = 20.0
"""Seconds after which a call stops trying to start simulators; its client would not wait longer."""
STEP_S: Final = 0.1
"""Seconds between two decisions."""
_T = TypeVar("_T")


class ReplayFailedError(Exception):
    """The episode could not be replayed. The infrastructure failed, not the agent."""


def aborted_outcome(trial: Trial, time_s: float) -> Outcome:
    """Return the outcome of an episode that was aborted after ``time_s`` seconds, without a simulator."""
    reaction = None if trial.fault.kind is FaultKind.NONE else Reaction.OTHER
    return Outcome(verdict=Verdict.ABORTED, reaction=reaction, time=time_s, max_deceleration=0.0)


def aborted_end(episode: OpenEpisode) -> EpisodeEnd:
    """Return the end of an open episode that is aborted without a simulator. It has no trajectory."""
    return EpisodeEnd(aborted_outcome(episode.trial, episode.seq * STEP_S), episode.seq, b"", "", "")


class EpisodeDriver:
    """Begins, steps and aborts episodes. Callers hold the episode's lock."""

    def __init__(
        self,
        pool: SimulatorPool,
        queue: SimulatorQueue,
        on_replay: Callable[[], None] = lambda: None,
        on_simulated: Callable[[Call, float], None] = lambda _call, _seconds: None,
    ) -> None:
        """Create a driver without episodes.

        Args:
            pool: The simulators.
            queue: Decides which agent gets the next simulator.
            on_replay: Called after each replay.
            on_simulated: Called with each call to a simulator and the seconds it took.
        """
        self._pool = pool
        self._queue = queue
        self._on_simulated = on_simulated
        self._on_replay = on_replay
        self._log = structlog.get_logger("driver")

    async def begin(self, episode: OpenEpisode, encoding: Encoding, call: str) -> StepResult:
        """Reset an episode.

        Args:
            episode: The episode.
            encoding: Encoding of the observation.
            call: Name of the request. A request that is sent again keeps its place in the queue.

        Raises:
            UnavailableError: Other calls come first.
            EpisodeRefusedError, SimulatorsBusyError, SimulatorStartError, ReplayFailedError.
        """
        self._queue.enter(episode.holder, call)
        episode.placed = True
        try:
            return await self._begin(episode, encoding)
        except BaseException:
            await self.detach(episode)
            raise

    async def _begin(self, episode: OpenEpisode, encoding: Encoding) -> StepResult:
        trial = episode.trial.model_dump_json()
        async for simulator in self._simulators(episode):
            try:
                result = await self._timed("reset", simulator.reset(trial, episode.track, b"", encoding))
            except SimulatorDiedError as error:
                self._log.warning("reset failed", trial=episode.trial.id, reason=str(error))
                await self._pool.release(simulator)
                continue
            except BaseException:
                await self._pool.release(simulator)
                raise
            episode.simulator = simulator
            return result
        raise ReplayFailedError(f"{ATTEMPTS} simulators failed to begin the episode")

    async def step(self, episode: OpenEpisode, action: Action, encoding: Encoding) -> StepResult:
        """Take one step.

        Raises:
            UnavailableError: The episode's simulator was given to another agent, and other calls come first.
            SimulatorsBusyError: No simulator is free.
            SimulatorStartError: No simulator starts. The episode stays open, so the step can be sent again.
            ReplayFailedError.
        """
        simulator = episode.simulator
        if simulator is not None:
            try:
                return await self._timed("step", simulator.step(action, encoding))
            except SimulatorDiedError as error:
                self._log.warning("simulator died in an episode", episode=episode.id, reason=str(error))
        return await self._in_another(episode, lambda found: self._timed("step", found.step(action, encoding)))

    async def view(self, episode: OpenEpisode) -> bytes:
        """Return a picture of the episode's moment, as a pixmap.

        Raises:
            UnavailableError, SimulatorsBusyError, SimulatorStartError, ReplayFailedError: As :meth:`step`.
        """
        simulator = episode.simulator
        if simulator is not None:
            try:
                return await self._timed("view", simulator.view())
            except SimulatorDiedError as error:
                self._log.warning("simulator died in an episode", episode=episode.id, reason=str(error))
        return await self._in_another(episode, lambda found: self._timed("view", found.view()))

    async def abort(self, episode: OpenEpisode) -> EpisodeEnd:
        """End an episode as ``aborted``. If every simulator fails, the end has no trajectory.

        Raises:
            UnavailableError: Other calls come first.
        """
        try:
            simulator = episode.simulator
            if simulator is not None:
                try:
                    return await self._timed("abort", simulator.abort())
                except SimulatorDiedError as error:
                    self._log.warning("simulator died in an episode", episode=episode.id, reason=str(error))
            return await self._in_another(episode, lambda found: self._timed("abort", found.abort()))
        except (ReplayFailedError, SimulatorStartError):
            return aborted_end(episode)

    async def detach(self, episode: OpenEpisode) -> None:
        """Release the episode's simulator and its place in the queue."""
        try:
            await self._release(episode)
        finally:
            if episode.placed:
                episode.placed = False
                self._queue.leave(episode.holder)

    async def _release(self, episode: OpenEpisode) -> None:
        simulator, episode.simulator = episode.simulator, None
        if simulator is not None:
            await self._pool.release(simulator)

    async def _timed(self, call: Call, answer: Awaitable[_T]) -> _T:
        began = time.perf_counter()
        try:
            return await answer
        finally:
            self._on_simulated(call, time.perf_counter() - began)

    async def _simulators(self, episode: OpenEpisode) -> AsyncIterator[Simulator]:
        """Yield up to :data:`ATTEMPTS` simulators. One that does not start counts as an attempt.

        Raises:
            SimulatorsBusyError.
            SimulatorStartError: The last one did not start.
        """
        began = time.monotonic()
        for attempt in range(1, ATTEMPTS + 1):
            try:
                simulator = await self._pool.acquire(episode.trial.town, episode.holder)
            except SimulatorStartError as error:
                if attempt == ATTEMPTS or time.monotonic() - began > START_PATIENCE_S:
                    raise
                self._log.warning("simulator did not start", reason=str(error))
            else:
                yield simulator

    async def _in_another(self, episode: OpenEpisode, call: Callable[[Simulator], Awaitable[_T]]) -> _T:
        """Replay the episode in another simulator and make the call there.

        An episode whose simulator died keeps its place, so that no other call gets in between.
        """
        await self._release(episode)
        if not episode.placed:
            self._queue.enter(episode.holder, episode.id)
            episode.placed = True
        try:
            return await self._replayed(episode, call)
        except BaseException:
            if episode.simulator is None:
                await self.detach(episode)
            raise

    async def _replayed(self, episode: OpenEpisode, call: Callable[[Simulator], Awaitable[_T]]) -> _T:
        async for simulator in self._simulators(episode):
            episode.simulator = simulator
            try:
                again = simulator.reset(
                    episode.trial.model_dump_json(), episode.track, bytes(episode.actions), episode.last.encoding
                )
                result = await self._timed("replay", again)
                if result.observation != episode.last.observation:
                    self._log.error("replay differs", episode=episode.id, seq=episode.seq)
                    await self._release(episode)
                    continue
                self._on_replay()
                return await call(simulator)
            except SimulatorDiedError as error:
                self._log.warning("replay failed", episode=episode.id, seq=episode.seq, reason=str(error))
                await self._release(episode)
        raise ReplayFailedError(f"{ATTEMPTS} simulators failed to replay the episode")
