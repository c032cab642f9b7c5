"""Decides which submission is checked or driven when, and carries it to its end.

What is to be done stands in the database alone, so a service that dies goes on where it was: a ``queued`` submission is
checked (again), a ``checked`` one waits for its turn, and a ``running`` one gets another runner.
"""

import asyncio
import contextlib
from collections import Counter
from collections.abc import Sequence
from typing import Final

import structlog

from wrongturn_protocol import SubmissionState
from wrongturn_service.settings import CHECKS
from wrongturn_service.storage.models import SubmissionRow
from wrongturn_service.submissions.availability import LOOK_S
from wrongturn_service.submissions.jobs import Check, Drive, Job, JobContext
from wrongturn_service.submissions.operations import OverError, RefusedError
from wrongturn_service.submissions.order import in_turn
from wrongturn_service.submissions.runners import HaltedError

_PAUSE_S: Final = 5.0
"""Seconds before a job is tried again that failed because of the service itself, such as its database."""
_STOP_S: Final = 10.0
"""Seconds that jobs get to end their runners and to write down what they know."""


class JobPool:
    """Jobs of one kind: how many at a time, who has them, and in which turn each owner and address was last served."""

    def __init__(self, slots: int, kind: type[Job]) -> None:
        self.slots = slots
        self.kind = kind
        self.served: dict[str, int] = {}
        self.jobs: dict[str, Job] = {}

    def next(self, rows: Sequence[SubmissionRow]) -> SubmissionRow | None:
        """Return which of these submissions gets a slot, None if there is none."""
        if len(self.jobs) >= self.slots:
            return None
        running = [job.row.names for job in self.jobs.values()]
        return next(
            iter(in_turn([row for row in rows if row.id not in self.jobs], running, self.served, self.slots)), None
        )


class Dispatcher:
    """Checks and drives submissions. :meth:`open` begins, once the service listens."""

    def __init__(self, context: JobContext) -> None:
        self._context = context
        self._submissions = context.submissions
        self._checks = JobPool(CHECKS, Check)
        self._drives = JobPool(context.settings.submissions, Drive)
        self._stopping = False
        self._changed = asyncio.Event()
        context.submissions.changed = self.wake
        self._loop: asyncio.Task[None] | None = None
        self._log = structlog.get_logger("submissions")

    async def open(self, url: str) -> None:
        """Begin to check and drive. Call it once the service listens, with the URL at which runners reach it."""
        self._context.url = url
        self._context.runners.open(url)
        self._drives.served = await self._submissions.rows.last_served()
        await self._context.availability.look()
        self._loop = asyncio.create_task(self._run())

    def wake(self) -> None:
        """Look at the line and for sandboxes now."""
        self._changed.set()

    async def stop(self) -> None:
        """End all runners. Their submissions wait in the database for the next start. Safe to call more than once."""
        self._stopping = True
        self._changed.set()
        jobs = [*self._checks.jobs.values(), *self._drives.jobs.values()]
        for job in jobs:
            job.halt.set()
        tasks = [task for task in (*(job.task for job in jobs), self._loop) if task is not None]
        if tasks:
            _, late = await asyncio.wait(tasks, timeout=_STOP_S)
            for task in late:
                self._log.warning("a job of submissions does not end in time")
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        self._loop = None
        await self._context.runners.close()

    async def positions(self) -> dict[str, int]:
        """Return for each waiting submission how many are driven before it, if no other one arrives."""
        rows, turns = await self._submissions.rows.waiting(), await self._submissions.rows.turns()
        running = [row for row in rows if row.state == SubmissionState.RUNNING]
        owners = [row.names for row in sorted(running, key=lambda row: turns.get(row.id, 0))]
        waiting = [row for row in rows if row.state != SubmissionState.RUNNING]
        ordered = in_turn(waiting, owners, self._drives.served, self._drives.slots)
        return {row.id: position for position, row in enumerate(ordered)}

    async def _run(self) -> None:
        while not self._stopping:
            self._changed.clear()
            try:
                await self._look()
            except Exception:
                self._log.exception("the line of submissions could not be read; trying again")
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LOOK_S if self._context.availability.on else _PAUSE_S):
                    await self._changed.wait()

    async def _look(self) -> None:
        """End the jobs of submissions that are over, and begin as many as there are slots."""
        await self._context.availability.look_if_due()
        if self._stopping:
            return
        rows = await self._submissions.rows.waiting()
        self._context.telemetry.submissions(Counter(SubmissionState(row.state) for row in rows))
        still_open = {row.id for row in rows}
        for pool in (self._checks, self._drives):
            for submission, job in pool.jobs.items():
                if submission not in still_open:
                    job.halt.set()
        if not self._context.availability.on or self._stopping:
            return
        by_state = {state: [row for row in rows if row.state == state] for state in SubmissionState}
        while (row := self._checks.next(by_state[SubmissionState.QUEUED])) is not None:
            self._begin(self._checks, row)
        # Those that have begun go first, in the order of arrival.
        for row in by_state[SubmissionState.RUNNING]:
            if row.id not in self._drives.jobs and len(self._drives.jobs) < self._drives.slots:
                self._begin(self._drives, row)
        while (row := self._drives.next(by_state[SubmissionState.CHECKED])) is not None:
            self._begin(self._drives, row)

    def _begin(self, pool: JobPool, row: SubmissionRow) -> None:
        if row.state != SubmissionState.RUNNING:
            pool.served |= dict.fromkeys(row.names, max(pool.served.values(), default=0) + 1)
        pool.jobs[row.id] = job = pool.kind(self._context, row)
        job.task = asyncio.create_task(self._work(job))
        job.task.add_done_callback(lambda _task: self._ended(pool, row.id))

    def _ended(self, pool: JobPool, submission: str) -> None:
        del pool.jobs[submission]
        self._changed.set()

    async def _work(self, job: Job) -> None:
        """Check or drive a submission. What goes wrong in the service itself is tried again later."""
        submission = job.row.id
        try:
            now = await self._submissions.rows.get(submission)
            if now is None or now.state != job.row.state:
                return  # another job ended with it while the line was read
            job.row = now
            try:
                await job.run()
            except RefusedError as error:
                await self._submissions.end(submission, SubmissionState.FAILED, str(error))
            else:
                if job.done is not None:
                    await self._submissions.end(submission, job.done)
        except (OverError, HaltedError):
            return
        except Exception:
            self._log.exception("submission job failed; trying again", submission=submission)
            with contextlib.suppress(HaltedError):
                await job.pause(_PAUSE_S)
