"""Ends of episodes. A verdict is stored before anybody learns of it."""

import contextlib
import zlib
from collections.abc import Collection

import structlog
from sqlalchemy.exc import SQLAlchemyError

from wrongturn_protocol import Verdict
from wrongturn_service.encoding import Encoding
from wrongturn_service.episodes.driver import EpisodeDriver, aborted_end
from wrongturn_service.episodes.evaluations import RunningEvaluations, finished
from wrongturn_service.episodes.open_episode import OpenEpisode
from wrongturn_service.episodes.registry import Registry
from wrongturn_service.simulators.action_log import ACTION
from wrongturn_service.storage.store import Store
from wrongturn_service.telemetry import Telemetry


class Endings:
    """Ends open episodes. Callers hold the episode's lock unless a method says that it takes it."""

    def __init__(
        self,
        store: Store,
        driver: EpisodeDriver,
        evaluations: RunningEvaluations,
        registry: Registry,
        telemetry: Telemetry,
    ) -> None:
        self._store = store
        self._driver = driver
        self._evaluations = evaluations
        self._registry = registry
        self._telemetry = telemetry
        self._log = structlog.get_logger("episodes")

    async def settle(self, episode: OpenEpisode) -> None:
        """Store an episode's end and close it. Raises SQLAlchemy's errors; safe to call again."""
        end = episode.end
        assert end is not None
        values = {
            "verdict": end.outcome.verdict.value,
            "outcome": end.outcome.model_dump_json(),
            "steps": end.steps,
            "actions_sha256": end.actions_sha256 or None,
            "trajectory_sha256": end.trajectory_sha256 or None,
            "last_action": bytes(episode.actions[-ACTION.size :]) or None,
            "last_reply": zlib.compress(episode.last.render(Encoding.JSON)) if episode.seq else None,
        }
        stored = await self._store.finish_episode(episode.id, values, end.trajectory, end.trajectory_sha256)
        await self._close(episode)
        if episode.evaluation is None:
            if stored:
                self._telemetry.ended(scored=False, verdict=end.outcome.verdict.value)
            return
        # Scored verdicts are hidden, also from those who read the metrics, until the whole evaluation is finished.
        if not stored:
            raise finished(episode.evaluation)
        self._log.info("episode finished", episode=episode.id, evaluation=episode.evaluation, steps=end.steps)
        schedule = self._evaluations.known(episode.evaluation)
        if schedule is not None:
            schedule.finish(episode.trial)
            await self._evaluations.finish_if_done(episode.evaluation)

    async def settle_again(self, episode: OpenEpisode) -> None:
        """Store an end again after the database refused it. Takes the lock."""
        async with episode.lock:
            if not episode.closed:
                with contextlib.suppress(SQLAlchemyError):
                    await self.settle(episode)

    async def abort(self, episode: OpenEpisode) -> None:
        """End an episode as ``aborted`` unless it is over. Takes the lock.

        Raises:
            UnavailableError: Its simulator was given to another agent, and other calls come first.
        """
        async with episode.lock:
            await self._abort(episode)

    async def expire(self, episode: OpenEpisode) -> None:
        """End an episode as ``aborted`` unless its agent came back. Takes the lock.

        Raises:
            UnavailableError: As for :meth:`abort`.
        """
        async with episode.lock:
            if episode.lease.expired and not episode.closed:
                await self._abort(episode)
                self._telemetry.expired.inc()

    async def invalidate(self, episode: OpenEpisode) -> None:
        """End an episode after a failure of the infrastructure. It does not count, and its trial runs again."""
        self._log.error("episode invalid", episode=episode.id, trial=episode.trial.id)
        self._telemetry.voided("simulators-failed")
        await self._store.lose_episode(episode.id, Verdict.INVALID)
        await self._close(episode)
        self._put_back(episode)

    def _put_back(self, episode: OpenEpisode) -> None:
        schedule = None if episode.evaluation is None else self._evaluations.known(episode.evaluation)
        if schedule is not None:
            schedule.put_back(episode.trial)

    async def abort_now(self, episode: OpenEpisode) -> None:
        """End an episode as ``aborted`` unless it is over, without waiting for a simulator. Takes the lock."""
        async with episode.lock:
            await self._abort(episode, wait=False)

    async def drop_evaluation(self, evaluation_id: str) -> None:
        """Close the open episodes of an evaluation that is over. Takes their locks."""
        for episode in self._registry:
            if episode.evaluation == evaluation_id:
                async with episode.lock:
                    if not episode.closed:
                        self._telemetry.voided("cancelled")
                    await self._close(episode)

    async def drop_holders(self, holders: Collection[str]) -> None:
        """Close the open episodes of agents and runners that were deleted. Takes their locks.

        Args:
            holders: Ids of agents and submissions.
        """
        for episode in self._registry:
            if episode.holder in holders:
                async with episode.lock:
                    if not episode.closed:
                        self._telemetry.voided("cancelled")
                    await self._close(episode)

    async def lose(self, holder: str) -> None:
        """Give up the open episodes of a runner that is gone; their trials run again. Takes their locks.

        Args:
            holder: Id of the submission.
        """
        for episode in self._registry:
            if episode.holder != holder:
                continue
            async with episode.lock:
                if episode.closed:
                    continue
                if episode.end is not None:
                    await self.settle(episode)  # the last step was taken, but its end was not stored yet
                    continue
                self._telemetry.voided("runner-ended")
                await self._store.lose_episode(episode.id)
                await self._close(episode)
                self._put_back(episode)

    async def _abort(self, episode: OpenEpisode, *, wait: bool = True) -> None:
        if episode.closed:
            return
        if episode.end is None:
            simulated = wait or episode.simulator is not None
            episode.end = await self._driver.abort(episode) if simulated else aborted_end(episode)
            await self._driver.detach(episode)
        await self.settle(episode)

    async def _close(self, episode: OpenEpisode) -> None:
        if episode.closed:
            return
        episode.closed = True
        self._registry.remove(episode)
        await self._driver.detach(episode)
