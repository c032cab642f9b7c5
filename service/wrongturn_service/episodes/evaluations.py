"""Evaluations that are being run: which trial comes next, and what is done when the last has its verdict."""

import asyncio
from collections.abc import Callable

import structlog

from wrongturn_networks import load_suite
from wrongturn_protocol import EpisodeState, EvaluationState, ProblemType
from wrongturn_service.episodes.schedule import Schedule
from wrongturn_service.errors import ConflictError
from wrongturn_service.storage.models import EvaluationRow
from wrongturn_service.storage.store import Store


class RunningEvaluations:
    """The schedules of running evaluations, laid out from the database when they are first needed."""

    def __init__(self, store: Store, on_finished: Callable[[str], None] = lambda _suite: None) -> None:
        """Nothing is read yet.

        Args:
            store: where evaluations and episodes are.
            on_finished: called with the suite of each evaluation that is finished.
        """
        self._store = store
        self._on_finished = on_finished
        self._schedules: dict[str, Schedule] = {}
        self._locks: dict[str, asyncio.Lock] = {}
        self._log = structlog.get_logger("evaluations")

    async def schedule(self, evaluation: EvaluationRow) -> Schedule:
        """An evaluation's trials.

        Raises:
            ConflictError: it is finished, cancelled, or its suite is another one by now.
        """
        if evaluation.state == EvaluationState.CANCELLED:
            raise cancelled(evaluation.id)
        if evaluation.state == EvaluationState.FINISHED:
            raise finished(evaluation.id)
        async with self._locks.setdefault(evaluation.id, asyncio.Lock()):
            found = self._schedules.get(evaluation.id)
            if found is None:
                suite = load_suite(evaluation.suite)
                if suite.sha256 != evaluation.suite_sha256:
                    raise ConflictError(
                        ProblemType.EVALUATION_CANCELLED,
                        f"evaluation {evaluation.id}: {evaluation.suite} is not what it was when the evaluation "
                        "began; begin another",
                    )
                done = await self._store.trials_by_state(evaluation.id)
                found = Schedule(suite.episodes, evaluation.secret, done[EpisodeState.FINISHED])
                self._schedules[evaluation.id] = found
                # Only now would a cancelling find it to drop it; one that came before is seen here.
                newest = await self._store.evaluation(evaluation.id)
                if newest is None or newest.state == EvaluationState.CANCELLED:
                    self.drop(evaluation.id)
                    raise cancelled(evaluation.id)
        return found

    def known(self, evaluation_id: str) -> Schedule | None:
        """The schedule, where one is laid out."""
        return self._schedules.get(evaluation_id)

    def drop(self, evaluation_id: str) -> None:
        """It was cancelled."""
        self._schedules.pop(evaluation_id, None)

    async def finish_if_done(self, evaluation_id: str) -> None:
        """Compute and store the metrics once each trial has its verdict; what fails is logged and tried again."""
        schedule = self._schedules.get(evaluation_id)
        if schedule is None or not schedule.finished:
            return
        async with self._locks.setdefault(evaluation_id, asyncio.Lock()):
            if self._schedules.get(evaluation_id) is not schedule:
                return
            try:
                await self._finish(evaluation_id)
            except Exception:
                self._log.exception("metrics failed", evaluation=evaluation_id)
                return
            del self._schedules[evaluation_id]
        self._locks.pop(evaluation_id, None)

    async def resume(self) -> None:
        """After a start: finish what had its last verdict when the service ended."""
        for evaluation in await self._store.running_evaluations():
            try:
                schedule = await self.schedule(evaluation)
            except Exception:
                self._log.exception("evaluation cannot go on", evaluation=evaluation.id)
                continue
            if schedule.finished:
                await self.finish_if_done(evaluation.id)

    async def retry(self) -> None:
        """Finish those whose metrics failed before."""
        for evaluation_id, schedule in list(self._schedules.items()):
            if schedule.finished:
                await self.finish_if_done(evaluation_id)

    async def _finish(self, evaluation_id: str) -> None:
        evaluation = await self._store.evaluation(evaluation_id)
        assert evaluation is not None
        outcomes = await self._store.outcomes(evaluation_id)
        suite = load_suite(evaluation.suite)

        def compute() -> str:
            from wrongturn_service.evaluation import metrics  # noqa: PLC0415 - statistics are heavy, and rarely needed

            return metrics.compute(suite, outcomes).model_dump_json()

        # The bootstrap takes a while; other agents' steps go on meanwhile.
        await self._store.finish_evaluation(evaluation_id, await asyncio.to_thread(compute))
        self._log.info("evaluation finished", evaluation=evaluation_id, suite=evaluation.suite)
        self._on_finished(evaluation.suite)


def cancelled(evaluation_id: str) -> ConflictError:
    """What calls on a cancelled evaluation get."""
    return ConflictError(
        ProblemType.EVALUATION_CANCELLED,
        f"evaluation {evaluation_id} was cancelled; begin another by POST /v1/evaluations",
    )


def finished(evaluation_id: str) -> ConflictError:
    """What a call for another trial gets when none is left."""
    return ConflictError(
        ProblemType.EVALUATION_FINISHED,
        f"evaluation {evaluation_id} is finished: each of its trials has a verdict; GET it for its metrics",
    )
