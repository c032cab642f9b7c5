"""The check of a submission: its model is loaded, and drives six steps of practice."""

import asyncio
import time
from typing import Final

import structlog

from wrongturn_networks import Suite
from wrongturn_protocol import SubmissionState, Track
from wrongturn_runner.messages import Check, Described, Passed, Practice, Refused
from wrongturn_service import catalogue
from wrongturn_service.storage.models import SubmissionRow
from wrongturn_service.submissions.errors import OverError, RefusedError
from wrongturn_service.submissions.jobs import Means
from wrongturn_service.submissions.runners import NoRoomError, RunnerLostError, runner

_LOAD_S: Final = 60.0
"""Seconds until the model has to be described. The runner itself gives a model less; this is for runners that hang."""
_PRACTICE_S: Final = 600.0
"""Seconds for the practice, which may have to wait for a simulator."""


class Checks:
    """Checks submissions."""

    def __init__(self, means: Means) -> None:
        self._means = means
        self._log = structlog.get_logger("submissions")

    async def run(self, row: SubmissionRow, url: str, halt: asyncio.Event) -> None:
        """Check a submission until it is ``checked``.

        Args:
            row: The submission, ``queued``.
            url: URL of the service.
            halt: Tells this job to end.

        Raises:
            RefusedError: The model is at fault, or no runner could check it.
            OverError: The submission was cancelled meanwhile.
            HaltedError: The job was told to end.
        """
        began, attempts = time.monotonic(), row.attempts
        await self._means.tell(row.id, "The check begins.")
        while True:
            await self._means.sandboxes(row.id, halt)
            try:
                passed = await self._once(row, url, halt)
                break
            except RunnerLostError as lost:
                attempts += not isinstance(lost, NoRoomError)
                await self._means.runner_gone(row.id)
                await self._means.lost(row, lost, attempts, halt)
            except RefusedError:
                self._means.telemetry.checks.observe(time.monotonic() - began)
                raise
        seconds = time.monotonic() - began
        self._means.telemetry.checks.observe(seconds)
        await self._means.runner_gone(row.id)
        slowest = f"; the slowest took {max(passed.step_ms):.1f} ms" if passed.step_ms else ""
        told = f"The model drove {len(passed.step_ms)} steps of practice{slowest}. It waits for its turn."
        if await self._means.submissions.rows.set_state(row.id, SubmissionState.CHECKED, attempts=0):
            await self._means.tell(row.id, told)
            self._log.info("submission checked", submission=row.id, seconds=round(seconds, 2))

    async def _once(self, row: SubmissionRow, url: str, halt: asyncio.Event) -> Passed:
        """Let one runner check the model until its last word.

        Raises:
            RefusedError: The model is at fault.
            RunnerLostError: The runner ended before it was done.
        """
        suite = catalogue.suite(row.suite)
        job = Check(
            model=self._means.model(row),
            sha256=row.sha256,
            place=self._means.place,
            tracks=suite.tracks,
            agent_track=None if row.agent_made or row.track is None else Track(row.track),
            url=url,
        )
        loop = asyncio.get_running_loop()
        async with runner(job, row.id, self._means.command, halt) as process:
            process.deadline = loop.time() + _LOAD_S
            async for event in process.events():
                match event:
                    case Described():
                        practice = await self._described(row.id, suite, event)
                        process.deadline = loop.time() + _PRACTICE_S
                        await process.send(practice)
                    case Refused():
                        raise RefusedError(event.reason)
                    case Passed():
                        return event
                    case _:
                        raise RunnerLostError(f"the runner said {event.event!r}, which makes no sense in a check")
        raise AssertionError("a runner's last word is passed or refused")

    async def _described(self, submission: str, suite: Suite, event: Described) -> Practice:
        """Make the agent if that is wanted, and return what the runner practises."""
        await self._means.tell(submission, f"The model was loaded: {event.description}. Its track is {event.track}.")
        agent = await self._means.submissions.make_agent(
            submission, event.track, description=event.about, trained_on_faults=event.trained_on_faults
        )
        if agent is None:
            raise OverError(submission)
        return Practice(token=await self._means.token(submission), suite=suite.id, trial=suite.trials[0].id)
