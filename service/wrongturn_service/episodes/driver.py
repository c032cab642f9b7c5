"""Drives open episodes in simulators, and repeats them in others when one dies: the agent notices nothing but time."""

import time
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Final, TypeVar

import structlog

from wrongturn_protocol import FaultKind, Outcome, Reaction, Verdict
from wrongturn_service.encoding import Encoding
from wrongturn_service.episodes.open_episode import OpenEpisode
from wrongturn_service.episodes.queue import SimulatorQueue
from wrongturn_service.simulators.action_log import Action
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
"""How many simulators may die of one call, or of their own start, before the episode is given up."""
START_PATIENCE_S: Final = 20.0
"""Seconds of a call after which a simulator that does not start is the last: the caller's own patience ends."""
STEP_S: Final = 0.1
"""Seconds of a decision."""
_T = TypeVar("_T")


class ReplayFailedError(Exception):
    """The episode could not be brought back: the infrastructure's failure, never the agent's."""


class EpisodeDriver:
    """Steps episodes; each call is made under the episode's lock."""

    def __init__(
        self,
        pool: SimulatorPool,
        line: SimulatorQueue,
        on_replay: Callable[[], None] = lambda: None,
        on_simulated: Callable[[Call, float], None] = lambda _call, _seconds: None,
    ) -> None:
        """Nothing is driven yet.

        Args:
            pool: the simulators.
            line: who gets the next one.
            on_replay: called when an episode was brought back.
            on_simulated: called with what a simulator was asked for and the seconds it took.
        """
        self._pool = pool
        self._line = line
        self._on_simulated = on_simulated
        self._on_replay = on_replay
        self._log = structlog.get_logger("driver")

    async def begin(self, episode: OpenEpisode, encoding: Encoding, call: str) -> StepResult:
        """The reset.

        Args:
            episode: what is begun.
            encoding: the encoding.
            call: what stands in the line for it; who comes back for the same keeps its place.

        Raises:
            UnavailableError: others come first.
            EpisodeRefusedError, SimulatorsBusyError, SimulatorStartError, ReplayFailedError.
        """
        self._line.enter(episode.agent, call)
        episode.placed = True
        try:
            return await self._begin(episode, encoding)
        except BaseException:
            await self.detach(episode)
            raise

    async def _begin(self, episode: OpenEpisode, encoding: Encoding) -> StepResult:
        trial = episode.trial.model_dump_json()
        async for simulator in self._simulators(episode.trial.town):
            try:
                frame = await self._timed("reset", simulator.reset(trial, episode.track, b"", encoding))
            except SimulatorDiedError as error:
                self._log.warning("reset failed", trial=episode.trial.id, reason=str(error))
                await self._pool.release(simulator)
                continue
            except BaseException:
                await self._pool.release(simulator)
                raise
            episode.simulator = simulator
            return frame
        raise ReplayFailedError(f"{ATTEMPTS} simulators failed to begin the episode")

    async def step(self, episode: OpenEpisode, action: Action, encoding: Encoding) -> StepResult:
        """One decision.

        Raises:
            UnavailableError: the episode's simulator was given to others, and others come first.
            SimulatorsBusyError: none is free.
            SimulatorStartError: none starts; the episode can be gone on with once one does.
            ReplayFailedError.
        """
        simulator = episode.simulator
        if simulator is not None:
            try:
                return await self._timed("step", simulator.step(action, encoding))
            except SimulatorDiedError as error:
                self._log.warning("simulator died in an episode", episode=episode.id, reason=str(error))
        return await self._elsewhere(episode, lambda found: self._timed("step", found.step(action, encoding)))

    async def abort(self, episode: OpenEpisode) -> EpisodeEnd:
        """EpisodeEnd it as ``aborted``; where no simulator can say more, by what is known without one.

        Raises:
            UnavailableError: others come first.
        """
        try:
            simulator = episode.simulator
            if simulator is not None:
                try:
                    return await self._timed("abort", simulator.abort())
                except SimulatorDiedError as error:
                    self._log.warning("simulator died in an episode", episode=episode.id, reason=str(error))
            return await self._elsewhere(episode, lambda found: self._timed("abort", found.abort()))
        except (ReplayFailedError, SimulatorStartError):
            reaction = None if episode.trial.fault.kind is FaultKind.NONE else Reaction.OTHER
            outcome = Outcome(
                verdict=Verdict.ABORTED,
                reaction=reaction,
                time=episode.seq * STEP_S,
                max_deceleration=0.0,
            )
            return EpisodeEnd(outcome, episode.seq, b"", "", "")

    async def detach(self, episode: OpenEpisode) -> None:
        """Give the episode's simulator back, and its place to the next."""
        try:
            await self._part(episode)
        finally:
            if episode.placed:
                episode.placed = False
                self._line.leave(episode.agent)

    async def _part(self, episode: OpenEpisode) -> None:
        simulator, episode.simulator = episode.simulator, None
        if simulator is not None:
            await self._pool.release(simulator)

    async def _timed(self, call: Call, answer: Awaitable[_T]) -> _T:
        began = time.perf_counter()
        try:
            return await answer
        finally:
            self._on_simulated(call, time.perf_counter() - began)

    async def _simulators(self, town: str) -> AsyncIterator[Simulator]:
        """Simulators to try one after the other; one that does not start counts as tried.

        Raises:
            SimulatorsBusyError.
            SimulatorStartError: the last did not start.
        """
        began = time.monotonic()
        for attempt in range(1, ATTEMPTS + 1):
            try:
                simulator = await self._pool.acquire(town)
            except SimulatorStartError as error:
                if attempt == ATTEMPTS or time.monotonic() - began > START_PATIENCE_S:
                    raise
                self._log.warning("simulator did not start", reason=str(error))
            else:
                yield simulator

    async def _elsewhere(self, episode: OpenEpisode, call: Callable[[Simulator], Awaitable[_T]]) -> _T:
        """Repeat the episode in another simulator, and make the call there.

        Where its simulator has died the episode keeps its place, so that nobody comes in between.
        """
        await self._part(episode)
        if not episode.placed:
            self._line.enter(episode.agent, episode.id)
            episode.placed = True
        try:
            return await self._repeated(episode, call)
        except BaseException:
            if episode.simulator is None:
                await self.detach(episode)
            raise

    async def _repeated(self, episode: OpenEpisode, call: Callable[[Simulator], Awaitable[_T]]) -> _T:
        async for simulator in self._simulators(episode.trial.town):
            episode.simulator = simulator
            try:
                again = simulator.reset(
                    episode.trial.model_dump_json(),
                    episode.track,
                    bytes(episode.actions),
                    episode.last.encoding,
                )
                frame = await self._timed("replay", again)
                if frame.observation != episode.last.observation:
                    self._log.error("replay differs", episode=episode.id, seq=episode.seq)
                    await self._part(episode)
                    continue
                self._on_replay()
                return await call(simulator)
            except SimulatorDiedError as error:
                self._log.warning("replay failed", episode=episode.id, seq=episode.seq, reason=str(error))
                await self._part(episode)
        raise ReplayFailedError(f"{ATTEMPTS} simulators failed to repeat the episode")
