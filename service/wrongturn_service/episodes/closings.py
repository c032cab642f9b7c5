"""Ends evaluations that are not driven to their end: what is begun counts."""

import asyncio
import time
from collections.abc import Callable, Collection
from typing import Final
from weakref import WeakValueDictionary

import structlog

from wrongturn_networks import load_suite
from wrongturn_protocol import EpisodeState, EvaluationState, Verdict
from wrongturn_service.episodes.driver import aborted_outcome
from wrongturn_service.episodes.episodes import Episodes
from wrongturn_service.episodes.evaluations import RunningEvaluations
from wrongturn_service.storage.models import EpisodeRow, EvaluationRow
from wrongturn_service.storage.store import Store
from wrongturn_service.tokens import new_id

GRACE_S: Final = 3600.0
"""Seconds after the start in which no evaluation is closed as overdue: it may have been the service's fault."""


class Closings:
    """Closes evaluations for their agents, and overdue ones by itself."""

    def __init__(
        self,
        store: Store,
        evaluations: RunningEvaluations,
        episodes: Episodes,
        idle_s: float,
        longest_s: float,
        clock: Callable[[], float] = time.time,
    ) -> None:
        """Close evaluations ``idle_s`` after their last reset or step, and ``longest_s`` after their begin.

        Otherwise one step a day would keep a bad one from ever becoming an entry.
        """
        self._store = store
        self._evaluations = evaluations
        self._episodes = episodes
        self._idle_s = idle_s
        self._longest_s = longest_s
        self._clock = clock
        self._began = clock()
        self._locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()
        self._log = structlog.get_logger("evaluations")

    async def close(self, evaluation_id: str) -> None:
        """Close a running evaluation. Safe to call again.

        Before its first step it is deleted. Later every trial without a verdict counts as ``aborted``, and the
        evaluation is finished. If that fails half-way, another call or the next start goes on with it.
        """
        lock = self._locks.setdefault(evaluation_id, asyncio.Lock())
        async with lock:
            evaluation = await self._store.evaluation(evaluation_id)
            if evaluation is None or evaluation.state != EvaluationState.RUNNING:
                return
            if await self._store.delete_undriven(evaluation_id):
                self._evaluations.drop(evaluation_id)
                await self._episodes.drop([evaluation_id])
                self._log.info("evaluation deleted before its first step", evaluation=evaluation_id)
                return
            with self._evaluations.closing(evaluation_id):
                await self._episodes.abort_evaluation(evaluation_id)
                await self._store.abort_rest(evaluation_id, await self._aborted(evaluation))
                self._evaluations.drop(evaluation_id)
                await self._episodes.drop([evaluation_id])
            self._log.info("evaluation closed", evaluation=evaluation_id)
            # From here on every trial has a verdict. The next start finishes the evaluation if this one fails.
            await self._evaluations.finish_closed(evaluation_id)

    async def drop(self, evaluations: Collection[str], holders: Collection[str]) -> None:
        """Let go of what was deleted in the database: evaluations, and agents and submissions whose practice ends."""
        for evaluation_id in evaluations:
            self._evaluations.drop(evaluation_id)
        await self._episodes.drop(evaluations, holders)

    async def close_overdue(self, spared: Collection[str] = ()) -> None:
        """Close the evaluations whose agents were idle for too long, and those that were begun too long ago.

        ``spared`` are those that the service itself drives: if one is idle, its agent is not to blame.
        """
        now = self._clock()
        if now - self._began < min(self._idle_s, GRACE_S):
            return
        for evaluation_id, begun, active in await self._store.running_since():
            if evaluation_id in spared:
                continue
            idle_s = now - active
            for episode in self._episodes.registry.of(evaluation_id):
                idle_s = min(idle_s, self._episodes.silence_s(episode))
            if idle_s >= self._idle_s or now - begun >= self._longest_s:
                self._log.warning("evaluation overdue", evaluation=evaluation_id, idle_s=int(idle_s))
                try:
                    await self.close(evaluation_id)
                except Exception:
                    self._log.exception("evaluation could not be closed", evaluation=evaluation_id)

    async def _aborted(self, evaluation: EvaluationRow) -> list[EpisodeRow]:
        """Return an episode for each trial and twin that ended before it began."""
        agent = await self._store.agent(evaluation.agent_id)
        if agent is None:  # deleted meanwhile
            return []
        now = self._clock()
        return [
            EpisodeRow(
                id=new_id("ep"),
                evaluation_id=evaluation.id,
                agent_id=evaluation.agent_id,
                trial_id=trial.id,
                trial=trial.model_dump_json(),
                track=agent.track,
                state=EpisodeState.FINISHED.value,
                created=now,
                finished=now,
                verdict=Verdict.ABORTED.value,
                outcome=aborted_outcome(trial, 0.0).model_dump_json(),
                steps=0,
            )
            for trial in load_suite(evaluation.suite).draw(evaluation.secret).episodes
        ]
