"""Episodes from reset to verdict. This module knows nothing of HTTP; it refuses calls with a ServiceError."""

import asyncio
import contextlib
import zlib
from typing import Final

from structlog.contextvars import bind_contextvars

from wrongturn_protocol import EpisodeState, EvaluationState, StepRequest, Verdict
from wrongturn_service.accounts import Caller
from wrongturn_service.encoding import Encoding
from wrongturn_service.episodes import refusals
from wrongturn_service.episodes.closings import Closings
from wrongturn_service.episodes.driver import EpisodeDriver
from wrongturn_service.episodes.endings import Endings
from wrongturn_service.episodes.evaluations import RunningEvaluations, cancelled
from wrongturn_service.episodes.lease import Terms
from wrongturn_service.episodes.loans import Loans
from wrongturn_service.episodes.open_episode import OpenEpisode, as_float32
from wrongturn_service.episodes.openings import PATIENCE_S, Openings
from wrongturn_service.episodes.registry import Limits, Registry
from wrongturn_service.episodes.steps import Steps, stored_reply
from wrongturn_service.episodes.watch import Watch
from wrongturn_service.errors import ConflictError, GoneError
from wrongturn_service.simulators.action_log import ACTION, Action
from wrongturn_service.storage.models import EpisodeRow
from wrongturn_service.storage.store import Store
from wrongturn_service.telemetry import Telemetry

_LOOK_S: Final = 0.02
_LOOKED_UP: Final = 4
"""Episodes that are looked up in the database at a time. More at once would only delay everything else."""


class EpisodeManager:
    """All episodes: open ones in memory, finished ones in the database."""

    def __init__(
        self,
        store: Store,
        driver: EpisodeDriver,
        evaluations: RunningEvaluations,
        *,
        terms: Terms,
        limits: Limits,
        telemetry: Telemetry,
        idle_s: float,
        longest_s: float,
    ) -> None:
        """Create a manager without open episodes.

        Args:
            store: Holds finished episodes.
            driver: Drives open episodes.
            evaluations: Holds the schedules of trials.
            terms: Limits of an agent's silence.
            limits: Limits on open episodes.
            telemetry: Counts the ends of episodes.
            idle_s: Seconds without a reset or a step after which an evaluation is closed.
            longest_s: Seconds after its begin when a driven evaluation is closed in any case.
        """
        self._store = store
        self._looking_up = asyncio.Semaphore(_LOOKED_UP)
        self._driver = driver
        self._registry = registry = Registry(limits)
        self._endings = endings = Endings(store, driver, evaluations, registry, telemetry)
        self.openings = Openings(store, driver, evaluations, registry, endings, terms)
        """Begins episodes."""
        self.closings = Closings(store, evaluations, registry, endings, idle_s, longest_s)
        """Closes evaluations."""
        self.steps = Steps(registry, driver, endings)
        """Takes plain steps."""
        self.loans = Loans(registry, self.steps)
        """Lends connections to simulators."""
        self._watch = Watch(registry, driver, endings, self.loans, terms)

    @property
    def open(self) -> int:
        """Number of open episodes."""
        return len(self._registry)

    @property
    def held(self) -> int:
        """Number of open episodes that have a simulator."""
        return self._registry.held

    def is_open(self, episode_id: str) -> bool:
        """Return whether an episode is open."""
        return self._registry.get(episode_id) is not None

    def driven(self, within_s: float) -> int:
        """Return how many open episodes had a call within the last ``within_s`` seconds."""
        return sum(episode.lock.locked() or episode.lease.silence_s < within_s for episode in self._registry)

    async def stop(self) -> None:
        """Refuse new episodes and cancel the work in the background. The next start marks open episodes as lost."""
        self.openings.stopping = True
        await self._watch.stop()

    async def watch_leases(self) -> None:
        """Check the leases until cancelled."""
        await self._watch.run()

    async def step(self, caller: Caller, episode_id: str, request: StepRequest, encoding: Encoding) -> bytes:
        """Take a step and return the reply's body.

        Raises:
            NotFoundError, ForbiddenError, GoneError, ConflictError, UnavailableError.
        """
        action = as_float32(request.action)
        episode = self._registry.get(episode_id)
        if episode is None:
            return await self._stored_step(caller, episode_id, request.seq, action, encoding)
        refusals.check_holder(caller.holder, episode)  # before the lock, which a stranger must not take
        bind_contextvars(episode=episode_id, evaluation=episode.evaluation)
        async with episode.lock:
            episode.lease.renew()
            if episode.closed:
                return await self._stored_step(caller, episode_id, request.seq, action, encoding)
            if refusals.check_step(episode, caller.holder, request.seq):
                if not await self._count(episode):
                    return await self._stored_step(caller, episode_id, request.seq, action, encoding)
                await self.steps.take(episode, action, encoding)
            else:
                refusals.check_same(episode_id, request.seq, action, episode.last_action)
            if episode.end is not None:
                await self._endings.settle(episode)
            episode.lease.renew()
            return episode.last.render(encoding)

    async def view(self, caller: Caller, episode_id: str) -> bytes | None:
        """Return a picture of an open practice episode's moment, as a pixmap; None if no such episode is open.

        Raises:
            ForbiddenError: The episode belongs to another agent, or counts.
            GoneError, UnavailableError.
        """
        episode = self._registry.get(episode_id)
        if episode is None:
            return None
        refusals.check_holder(caller.holder, episode)
        refusals.check_view(episode_id, episode.evaluation)
        async with episode.lock:
            episode.lease.renew()
            return None if episode.closed or episode.end is not None else await self.steps.view(episode)

    async def look(self, caller: Caller, episode_id: str) -> tuple[OpenEpisode | None, EpisodeRow]:
        """Return an episode, None unless it is open, and its row.

        Raises:
            NotFoundError.
        """
        episode = self._registry.get(episode_id)
        if episode is not None and episode.holder == caller.holder:
            episode.lease.renew()
            # A step may be in progress; an agent that comes back after a crash has to see its result.
            async with episode.lock:
                pass
        row = await self._stored(episode_id)
        return self._registry.get(episode_id), row

    def last_reply(self, episode_id: str, encoding: Encoding) -> tuple[int, bytes] | None:
        """Return the number and body of an open episode's last reply, or None."""
        episode = self._registry.get(episode_id)
        return None if episode is None else (episode.seq, episode.last.render(encoding))

    async def abort(self, caller: Caller, episode_id: str) -> None:
        """End an episode as ``aborted``. Safe to call more than once.

        Raises:
            ConflictError: The episode has another verdict.
            UnavailableError: Its simulator was given to another agent, and other calls come first.
            NotFoundError, ForbiddenError, GoneError.
        """
        episode = self._registry.get(episode_id)
        if episode is not None:
            refusals.check_holder(caller.holder, episode)
            episode.lease.renew()
            await self._endings.abort(episode)
        row = await self._row(caller, episode_id)
        if row.state != EpisodeState.FINISHED:
            raise await self._lost(row)
        if row.verdict != Verdict.ABORTED:
            raise refusals.episode_finished(episode_id)

    async def lose(self, submission: str, patience_s: float = PATIENCE_S) -> None:
        """Give up the open episodes of a runner that is gone, and whose token has ended. Their trials run again.

        Resets in progress would open episodes that nobody drives, so it waits for them.

        Args:
            submission: Id of the submission.
            patience_s: Seconds to wait for resets. Leases end what is opened later.
        """
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(patience_s):
                await self._endings.lose(submission)
                while self._registry.count(submission):
                    await asyncio.sleep(_LOOK_S)
                    await self._endings.lose(submission)

    async def _count(self, episode: OpenEpisode) -> bool:
        """Note before a step that the evaluation counts. Return False if it was closed before that."""
        if not episode.counts and episode.evaluation is not None:
            episode.counts = await self._store.drive_evaluation(episode.evaluation)
        return episode.counts

    async def _stored_step(
        self, caller: Caller, episode_id: str, seq: int, action: Action, encoding: Encoding
    ) -> bytes:
        """Answer a step of an episode that is no longer open: repeat the last reply, or refuse."""
        row = await self._row(caller, episode_id)
        if row.state != EpisodeState.FINISHED:
            raise await self._lost(row)
        if seq == row.steps and row.last_action is not None and row.last_reply is not None:
            steer, throttle, brake = ACTION.unpack(row.last_action)
            refusals.check_same(episode_id, seq, action, (steer, throttle, brake))
            return stored_reply(row, zlib.decompress(row.last_reply)).render(encoding)
        raise refusals.episode_finished(episode_id)

    async def _row(self, caller: Caller, episode_id: str) -> EpisodeRow:
        row = await self._stored(episode_id)
        caller.check_episode(row)
        return row

    async def _stored(self, episode_id: str) -> EpisodeRow:
        async with self._looking_up:
            row = await self._store.episode(episode_id)
        if row is None:
            raise refusals.unknown_episode(episode_id)
        return row

    async def _lost(self, row: EpisodeRow) -> GoneError | ConflictError:
        if row.evaluation_id is not None:
            evaluation = await self._store.evaluation(row.evaluation_id)
            if evaluation is not None and evaluation.state == EvaluationState.CANCELLED:
                return cancelled(evaluation)
        why = "its simulators failed" if row.verdict == Verdict.INVALID else "the service was restarted"
        return GoneError(f"episode {row.id} is lost: {why}; it does not count, so ask for the next trial")
