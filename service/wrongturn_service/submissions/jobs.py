"""A submission's jobs: its check, then its drive, by one runner after the other until every episode is over."""

import abc
import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import structlog
from typing_extensions import override

from wrongturn_protocol import Entry, EvaluationState, SubmissionState, Track
from wrongturn_protocol.rigs import rig_of
from wrongturn_runner import messages, pace
from wrongturn_service import catalogue
from wrongturn_service.episodes.episodes import PATIENCE_S, Episodes
from wrongturn_service.episodes.evaluations import RunningEvaluations, new_evaluation
from wrongturn_service.errors import ServiceError
from wrongturn_service.settings import Settings
from wrongturn_service.storage.models import EvaluationRow, SubmissionRow
from wrongturn_service.storage.store import Store
from wrongturn_service.storage.submissions import SubmissionOverError, SuiteBegunError
from wrongturn_service.submissions.availability import Availability
from wrongturn_service.submissions.operations import NO_MODEL, OverError, RefusedError, Submissions
from wrongturn_service.submissions.runners import HaltedError, NoRoomError, Runner, RunnerLostError, Runners
from wrongturn_service.telemetry import Telemetry

ATTEMPTS: Final = 5
"""Runners in a row that may end before they have done anything."""
_FIRST_PAUSE_S: Final = 0.25
_LONGEST_PAUSE_S: Final = 5.0
_LOOK_S: Final = 3.0
_PRACTICE: Final = "smoke@3"
"""The suite that a model practises if its own needs towns."""
_LOAD_S: Final = 60.0
"""Seconds until the model has to be described. The runner itself gives a model less; this is for runners that hang."""
_PRACTICE_S: Final = pace.PATIENCE_S + 300.0
"""Seconds for the practice, which may have to wait for a simulator: a slow reset is no runner that hangs."""
_PARTS: Final = 10
"""The log has a line for each tenth of the episodes."""
_METRICS_PAUSE_S: Final = 5.0
_PATIENCE_S: Final = 2.0
"""Seconds to wait for a runner's resets at its end. The next runner waits longer; a stop or a cancellation does not."""
_log = structlog.get_logger("submissions")


@dataclass
class JobContext:
    """Parts of the service that jobs use."""

    settings: Settings
    store: Store
    submissions: Submissions
    episodes: Episodes
    evaluations: RunningEvaluations
    availability: Availability
    telemetry: Telemetry
    runners: Runners
    url: str = ""
    """Where runners reach the service, once it listens."""


class Job(abc.ABC):
    """A submission that is being checked or driven."""

    done: ClassVar[SubmissionState | None] = None
    """State in which a submission ends whose job succeeded. None if it goes on."""
    verb: ClassVar[str]

    def __init__(self, context: JobContext, row: SubmissionRow) -> None:
        self.row = row
        self.halt = asyncio.Event()
        """Tells the job to end. Its task is not cancelled, because that would cut its writes to the database short."""
        self.task: asyncio.Task[None] | None = None
        self._context = context
        self._rows = context.submissions.rows

    @abc.abstractmethod
    async def run(self) -> None:
        """Work until the submission is checked or driven. Raises RefusedError, OverError, HaltedError."""

    async def pause(self, seconds: float) -> None:
        """Wait some seconds. Raises HaltedError as soon as the job is told to end."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self.halt.wait()
        if self.halt.is_set():
            raise HaltedError("the job has to end")

    async def _tell(self, message: str, *, again: bool = True) -> None:
        """Add a line to the submission's log, for its owner. Without ``again``, not if it is the last one already."""
        lines = [] if again else await self._rows.log(self.row.id)
        if not lines or lines[-1].message != message:
            await self._rows.append_log(self.row.id, message)

    def _model(self) -> dict[str, Any]:
        """Return the fields of a runner's job that tell about the model. Raises RefusedError if it is gone."""
        file = self._context.submissions.files.path(self.row.id)
        if not file.is_file():
            raise RefusedError(NO_MODEL)
        settings, url = self._context.settings, self._context.url
        sandbox = {"socket": settings.runner_socket, "memory": settings.model_memory}
        return {"model": file, "sha256": self.row.sha256, **sandbox, "url": url}

    async def _wait_for_sandboxes(self) -> None:
        if self._context.availability.on:
            return
        await self._tell("The service has no sandbox at the moment. It continues when a sandbox is free.", again=False)
        while not await self._context.availability.look():
            await self.pause(_LOOK_S)

    async def _runner_gone(self, patience_s: float = PATIENCE_S) -> None:
        """End the token of a runner that is gone, and give up its open episodes and its resets in progress."""
        await self._rows.set_columns(self.row.id, token_sha256=None)
        await self._context.episodes.lose(self.row.id, patience_s)

    @contextlib.asynccontextmanager
    async def _runner(self, job: messages.Job) -> AsyncIterator[Runner]:
        """Start a runner, and end it with all that it began. Raises RunnerLostError."""
        try:
            async with self._context.runners.start(job, self.row.id, self.halt) as process:
                yield process
        finally:
            await self._runner_gone(_PATIENCE_S)

    async def _lost(self, lost: RunnerLostError, attempts: int) -> int:
        """Note that a runner was lost, after so many in a row; wait a little, and return how many it is by now.

        Raises:
            RefusedError: They were too many, or the model is gone, which is why the runner ended.
            OverError: The submission is over, which may be why.
            HaltedError: The job was told to end.
        """
        attempts += not isinstance(lost, NoRoomError)
        if not await self._rows.set_columns(self.row.id, attempts=attempts):
            raise OverError(self.row.id)
        self._model()
        if isinstance(lost, NoRoomError):
            why = str(lost)
            await self._tell(f"{why[0].upper()}{why[1:]}. It continues when a sandbox is free.", again=False)
            await self.pause(_LONGEST_PAUSE_S)
            return attempts
        self._context.telemetry.runners_lost.inc()
        _log.warning("runner lost", submission=self.row.id, reason=str(lost), attempts=attempts)
        if attempts >= ATTEMPTS:
            raise RefusedError(
                f"the service could not {self.verb} it: {attempts} runners in a row ended before they were done, the "
                f"last one because {lost}; as far as the service can tell, the model is not to blame; ask the operator"
            )
        await self._tell(f"A runner was lost: {lost}. Runner {attempts + 1} of at most {ATTEMPTS} takes over.")
        await self._context.availability.look()
        await self.pause(min(_LONGEST_PAUSE_S, _FIRST_PAUSE_S * 2 ** (attempts - 1)))
        return attempts

    def _senseless(self, event: messages.Event) -> RunnerLostError:
        return RunnerLostError(f"the runner said {event.event!r}, which makes no sense in a {self.verb}")


class Check(Job):
    """The check: the model is loaded, and drives six steps of practice. Then the submission is ``checked``."""

    verb = "check"

    @override
    async def run(self) -> None:
        began, attempts = time.monotonic(), self.row.attempts
        await self._tell("The check begins.")
        while True:
            await self._wait_for_sandboxes()
            try:
                passed = await self._once()
                break
            except RunnerLostError as lost:
                attempts = await self._lost(lost, attempts)
            except RefusedError:
                self._context.telemetry.checks.observe(time.monotonic() - began)
                raise
        seconds = time.monotonic() - began
        self._context.telemetry.checks.observe(seconds)
        slowest = f"; the slowest took {max(passed.step_ms):.1f} ms" if passed.step_ms else ""
        if await self._rows.set_state(self.row.id, SubmissionState.CHECKED, attempts=0):
            await self._tell(
                f"The model drove {len(passed.step_ms)} steps of practice{slowest}. It waits for its turn."
            )
            _log.info("submission checked", submission=self.row.id, seconds=round(seconds, 2))

    async def _once(self) -> messages.Passed:
        """Let one runner check the model until its last word. Raises RefusedError, RunnerLostError."""
        row, suite = self.row, catalogue.suite(self.row.suite)
        agent = None if row.agent_made or row.agent_id is None else await self._context.store.agent(row.agent_id)
        job = messages.CheckJob(
            **self._model(),
            tracks=suite.tracks,
            agent_track=None if agent is None else Track(agent.track),
            agent_rig=None if agent is None else rig_of(agent.rig),
        )
        loop = asyncio.get_running_loop()
        async with self._runner(job) as process:
            process.deadline = loop.time() + _LOAD_S
            async for event in process.events():
                match event:
                    case messages.Described():
                        await self._tell(f"The model was loaded: {event.description}. Its track is {event.track}.")
                        submissions = self._context.submissions
                        await submissions.make_agent(
                            row.id, event.track, event.about, trained_on_faults=event.trained_on_faults, rig=event.rig
                        )
                        token = await submissions.give_token(row.id)
                        process.deadline = loop.time() + _PRACTICE_S
                        # The towns of its own suite may not be built.
                        practice = catalogue.suite(_PRACTICE) if suite.makes_towns else suite
                        trial = practice.trials[0].id
                        await process.send(messages.PracticeJob(token=token, suite=practice.id, trial=trial))
                    case messages.Refused():
                        raise RefusedError(event.reason)
                    case messages.Passed():
                        return event
                    case _:
                        raise self._senseless(event)
        raise AssertionError("a runner's last word is passed or refused")


class Drive(Job):
    """The drive of a submission that is ``checked`` or ``running``, until its evaluation is finished."""

    done = SubmissionState.FINISHED
    verb = "drive"

    @override
    async def run(self) -> None:
        if self.row.state == SubmissionState.CHECKED:
            await self._begin()
        else:
            await self._tell("The service was restarted. The drive goes on.")
        attempts, finished_count = self.row.attempts, self._context.store.finished_count
        while (evaluation := await self._running()) is not None:
            before = await finished_count(evaluation.id)
            if before == evaluation.trials:  # the metrics alone are missing
                await self._context.evaluations.finish_closed(evaluation.id)
                if await self._running() is not None:
                    _log.warning("metrics are not stored yet", evaluation=evaluation.id)
                    await self.pause(_METRICS_PAUSE_S)
                continue
            await self._wait_for_sandboxes()
            try:
                await self._once(evaluation.id, before)
                if await self._running() is not None and await finished_count(evaluation.id) < evaluation.trials:
                    raise RunnerLostError("the runner said that it was done, but episodes are missing")
            except RunnerLostError as lost:
                after = await finished_count(evaluation.id)
                attempts = await self._lost(lost, 0 if after > before else attempts)

    async def _begin(self) -> None:
        """Begin the evaluation by the rules for every agent."""
        row = self.row
        agent = await self._context.store.agent(row.agent_id or "")
        if agent is None:
            raise RefusedError("its agent was deleted; hand the model in again")
        try:
            evaluation = new_evaluation(
                catalogue.suite(row.suite), agent.id, Track(agent.track), rig_of(agent.rig), Entry.UPLOADED
            )
            await self._rows.begin_evaluation(row.id, evaluation)
        except ServiceError as error:
            raise RefusedError(error.detail) from error
        except SubmissionOverError as error:
            raise OverError(row.id) from error
        except SuiteBegunError as error:
            raise RefusedError(
                f"the agent {row.name!r} has begun {row.suite} by its own token meanwhile, and the first evaluation "
                "counts; hand the model in as a new agent"
            ) from error
        await self._tell(f"The drive begins: {evaluation.trials} episodes of {row.suite}, evaluation {evaluation.id}.")
        _log.info("submission begins to drive", submission=row.id, evaluation=evaluation.id)
        begun = await self._rows.get(row.id)
        assert begun is not None
        self.row = begun

    async def _running(self) -> EvaluationRow | None:
        """Return the evaluation, None once it is finished. Raises RefusedError if it cannot go on."""
        evaluation = await self._context.store.evaluation(self.row.evaluation_id or "")
        if evaluation is None:
            raise RefusedError("its evaluation was deleted before its first step; hand the model in again")
        if evaluation.state == EvaluationState.CANCELLED:
            raise RefusedError("its evaluation was cancelled")
        return None if evaluation.state == EvaluationState.FINISHED else evaluation

    async def _once(self, evaluation: str, told: int) -> None:
        """Let one runner drive until its last word. Raises RefusedError, RunnerLostError.

        ``told`` episodes are over already, as the log says.
        """
        # A reset of the runner before may have opened an episode late.
        await self._runner_gone()
        job = messages.DriveJob(
            **self._model(),
            token=await self._context.submissions.give_token(self.row.id),
            evaluation=evaluation,
            suite=self.row.suite,
        )
        async with self._runner(job) as process:
            async for event in process.events():
                match event:
                    case messages.Progressed():
                        last = event.finished >= event.episodes
                        if last or (event.finished - told) * _PARTS >= event.episodes:
                            await self._tell(f"{event.finished} of {event.episodes} episodes are over.")
                            told = event.finished
                    case messages.Refused():
                        raise RefusedError(event.reason)
                    case messages.Driven():
                        break
                    case _:
                        raise self._senseless(event)
