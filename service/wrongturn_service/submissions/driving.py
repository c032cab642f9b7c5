"""The drive of a submission: its evaluation, by one runner after the other until every episode is over."""

import asyncio
from typing import Final

import structlog

from wrongturn_protocol import Entry, EvaluationState, SubmissionState, Track
from wrongturn_runner.messages import Drive, Driven, Progressed, Refused
from wrongturn_service import catalogue
from wrongturn_service.episodes.evaluations import new_evaluation
from wrongturn_service.errors import ServiceError
from wrongturn_service.storage.models import SubmissionRow
from wrongturn_service.storage.submissions import SubmissionOverError, SuiteBegunError
from wrongturn_service.submissions.errors import OverError, RefusedError
from wrongturn_service.submissions.jobs import Means, pause
from wrongturn_service.submissions.runners import NoRoomError, RunnerLostError, runner

_PARTS: Final = 10
"""The log has a line for each tenth of the episodes."""
_PAUSE_S: Final = 5.0
_PATIENCE_S: Final = 2.0
"""Seconds to wait for a runner's resets at its end. The next runner waits longer; a stop or a cancellation does not."""


class Drives:
    """Drives submissions."""

    def __init__(self, means: Means) -> None:
        self._means = means
        self._log = structlog.get_logger("submissions")

    async def run(self, row: SubmissionRow, url: str, halt: asyncio.Event) -> None:
        """Drive a submission until its evaluation is finished.

        Args:
            row: The submission, ``checked`` or ``running``.
            url: URL of the service.
            halt: Tells this job to end.

        Raises:
            RefusedError: The model is at fault, the evaluation cannot go on, or no runner could drive it.
            OverError: The submission was cancelled meanwhile.
            HaltedError: The job was told to end.
        """
        if row.state == SubmissionState.CHECKED:
            row = await self._begin(row)
        else:
            await self._means.tell(row.id, "The service was restarted. The drive goes on.")
        attempts = row.attempts
        while not await self._finished(row):
            await self._means.sandboxes(row.id, halt)
            before = await self._means.store.finished_count(row.evaluation_id or "")
            try:
                await self._once(row, url, before, halt)
            except RunnerLostError as lost:
                after = await self._means.store.finished_count(row.evaluation_id or "")
                attempts = (0 if after > before else attempts) + (not isinstance(lost, NoRoomError))
                await self._means.lost(row, lost, attempts, halt)

    async def _begin(self, row: SubmissionRow) -> SubmissionRow:
        """Begin the evaluation by the rules for every agent, and return the new row."""
        agent = await self._means.store.agent(row.agent_id or "")
        if agent is None:
            raise RefusedError("its agent was deleted; hand the model in again")
        try:
            evaluation = new_evaluation(catalogue.suite(row.suite), agent.id, Track(agent.track), Entry.UPLOADED)
            await self._means.submissions.rows.begin_evaluation(row.id, evaluation)
        except ServiceError as error:
            raise RefusedError(error.detail) from error
        except SubmissionOverError as error:
            raise OverError(row.id) from error
        except SuiteBegunError as error:
            raise RefusedError(
                f"the agent {row.name!r} has begun {row.suite} by its own token meanwhile, and the first evaluation "
                "counts; hand the model in as a new agent"
            ) from error
        await self._means.tell(
            row.id, f"The drive begins: {evaluation.trials} episodes of {row.suite}, evaluation {evaluation.id}."
        )
        self._log.info("submission begins to drive", submission=row.id, evaluation=evaluation.id)
        begun = await self._means.submissions.rows.get(row.id)
        assert begun is not None
        return begun

    async def _finished(self, row: SubmissionRow) -> bool:
        """Return whether the evaluation is finished. Raises RefusedError if it cannot go on."""
        evaluation = await self._means.store.evaluation(row.evaluation_id or "")
        if evaluation is None:
            raise RefusedError("its evaluation was deleted before its first step; hand the model in again")
        if evaluation.state == EvaluationState.CANCELLED:
            raise RefusedError(f"its evaluation was cancelled, because {row.suite} was retired")
        return evaluation.state == EvaluationState.FINISHED

    async def _once(self, row: SubmissionRow, url: str, before: int, halt: asyncio.Event) -> None:
        """Let one runner drive until its last word.

        Raises:
            RefusedError: The model is at fault.
            RunnerLostError: The runner ended before it was done.
        """
        assert row.evaluation_id is not None
        # A reset of the runner before may have opened an episode late.
        await self._means.runner_gone(row.id)
        job = Drive(
            model=self._means.model(row),
            sha256=row.sha256,
            place=self._means.place,
            url=url,
            token=await self._means.token(row.id),
            evaluation=row.evaluation_id,
            suite=row.suite,
        )
        told = before
        try:
            async with runner(job, row.id, self._means.command, halt) as process:
                async for event in process.events():
                    match event:
                        case Progressed():
                            told = await self._progressed(row.id, event, told)
                        case Refused():
                            raise RefusedError(event.reason)
                        case Driven():
                            break
                        case _:
                            raise RunnerLostError(f"the runner said {event.event!r}, which makes no sense in a drive")
        finally:
            await self._means.runner_gone(row.id, _PATIENCE_S)
        await self._settle(row.evaluation_id, halt)

    async def _progressed(self, submission: str, event: Progressed, told: int) -> int:
        """Tell the owner of each tenth. Returns how many episodes were told of last."""
        last = event.finished >= event.episodes
        if not last and (event.finished - told) * _PARTS < event.episodes:
            return told
        await self._means.tell(submission, f"{event.finished} of {event.episodes} episodes are over.")
        return event.finished

    async def _settle(self, evaluation_id: str, halt: asyncio.Event) -> None:
        """Wait until the metrics of an evaluation are stored, whose every episode is over.

        Raises:
            RunnerLostError: Episodes are missing, whatever the runner said.
        """
        while True:
            evaluation = await self._means.store.evaluation(evaluation_id)
            if evaluation is None or evaluation.state != EvaluationState.RUNNING:
                return
            if await self._means.store.finished_count(evaluation_id) < evaluation.trials:
                raise RunnerLostError("the runner said that it was done, but episodes are missing")
            await self._means.evaluations.finish_closed(evaluation_id)
            evaluation = await self._means.store.evaluation(evaluation_id)
            if evaluation is not None and evaluation.state == EvaluationState.RUNNING:
                self._log.warning("metrics are not stored yet", evaluation=evaluation_id)
                await pause(_PAUSE_S, halt)
