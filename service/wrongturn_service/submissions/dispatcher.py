"""Decides which submission is checked or driven when, and carries it to its end.

What is to be done stands in the database alone, so a service that dies goes on where it was: a ``queued`` submission is
checked (again), a ``checked`` one waits for its turn, and a ``running`` one gets another runner.
"""

import asyncio
import contextlib
from collections import Counter
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import structlog

from wrongturn_protocol import SubmissionState
from wrongturn_service.episodes.evaluations import RunningEvaluations
from wrongturn_service.episodes.manager import EpisodeManager
from wrongturn_service.settings import Settings
from wrongturn_service.storage.models import SubmissionRow
from wrongturn_service.storage.store import Store
from wrongturn_service.submissions.availability import LOOK_S, Availability
from wrongturn_service.submissions.checking import Checks
from wrongturn_service.submissions.driving import Drives
from wrongturn_service.submissions.errors import HaltedError, OverError, RefusedError
from wrongturn_service.submissions.jobs import Means, pause
from wrongturn_service.submissions.operations import Submissions
from wrongturn_service.submissions.order import Waiting, in_turn, next_one
from wrongturn_service.submissions.runners import COMMAND
from wrongturn_service.telemetry import Telemetry

CHECKS: Final = 2
"""Submissions that are checked at a time."""
_PAUSE_S: Final = 5.0
"""Seconds before a job is tried again that failed because of the service itself, such as its database."""
_STOP_S: Final = 10.0
"""Seconds that jobs get to end their runners and to write down what they know."""

Work = Callable[[SubmissionRow, str, asyncio.Event], Awaitable[None]]


@dataclass(eq=False)
class _Job:
    """A submission that is being checked or driven.

    Attributes:
        row: The submission when the job began.
        halt: Tells the job to end. It is not cancelled, because that would cut its writes to the database short.
        task: Does the work.
    """

    row: SubmissionRow
    halt: asyncio.Event = field(default_factory=asyncio.Event)
    task: "asyncio.Task[None] | None" = None


class _Desk:
    """Jobs of one kind: how many at a time, who has them, and who was served when."""

    def __init__(self, slots: int, work: Work, done: SubmissionState | None) -> None:
        self.slots = slots
        self.work = work
        self.done = done
        """State in which a submission ends whose work succeeded. None if it goes on."""
        self.served: dict[str, int] = {}
        self.jobs: dict[str, _Job] = {}

    def next(self, rows: Sequence[SubmissionRow]) -> SubmissionRow | None:
        """Return which of these submissions gets a place, None if there is none."""
        if len(self.jobs) >= self.slots:
            return None
        running = Counter(job.row.owner_id for job in self.jobs.values())
        chosen = next_one([_waiting(row) for row in rows if row.id not in self.jobs], running, self.served)
        return None if chosen is None else next(row for row in rows if row.id == chosen.id)

    def serve(self, owner: str) -> None:
        """Note that an owner is served."""
        self.served[owner] = max(self.served.values(), default=0) + 1


class Dispatcher:
    """Checks and drives submissions. :meth:`open` begins, once the service listens."""

    def __init__(
        self,
        settings: Settings,
        store: Store,
        submissions: Submissions,
        episodes: EpisodeManager,
        evaluations: RunningEvaluations,
        availability: Availability,
        telemetry: Telemetry,
        command: Sequence[str] = COMMAND,
    ) -> None:
        """Create a dispatcher that does nothing yet.

        Args:
            settings: Settings of the service.
            store: Holds agents, evaluations and episodes.
            submissions: Holds the submissions, and tells of changes from now on.
            episodes: Holds the open episodes.
            evaluations: Holds the schedules of running evaluations.
            availability: Knows whether there are sandboxes.
            telemetry: Metrics.
            command: Program of a runner.
        """
        self._availability = availability
        self._rows = submissions.rows
        self._submissions = submissions
        self._telemetry = telemetry
        means = Means(settings, store, submissions, episodes, evaluations, availability, telemetry, command)
        self._checks = _Desk(CHECKS, Checks(means).run, None)
        self._drives = _Desk(settings.submissions, Drives(means).run, SubmissionState.FINISHED)
        self._url = ""
        self._stopping = False
        self._changed = asyncio.Event()
        submissions.changed = self._changed.set
        self._loop: asyncio.Task[None] | None = None
        self._log = structlog.get_logger("submissions")

    async def open(self, url: str) -> None:
        """Begin to check and drive. Call it once the service listens.

        Args:
            url: URL at which runners reach the service.
        """
        self._url = url
        self._drives.served = await self._rows.last_served()
        await self._availability.look()
        self._loop = asyncio.create_task(self._run())

    async def stop(self) -> None:
        """End all runners. Their submissions wait in the database for the next start. Safe to call again."""
        self._stopping = True
        self._changed.set()
        jobs = [job for desk in self._desks for job in desk.jobs.values()]
        for job in jobs:
            job.halt.set()
        tasks = [job.task for job in jobs if job.task is not None] + ([] if self._loop is None else [self._loop])
        if tasks:
            _, late = await asyncio.wait(tasks, timeout=_STOP_S)
            for task in late:
                self._log.warning("a job of submissions does not end in time")
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        self._loop = None

    async def positions(self) -> dict[str, int]:
        """Return for each waiting submission how many are driven before it, if no other one arrives."""
        rows, turns = await self._rows.waiting(), await self._rows.turns()
        running = [row for row in rows if row.state == SubmissionState.RUNNING]
        owners = [row.owner_id for row in sorted(running, key=lambda row: turns.get(row.id, 0))]
        waiting = [_waiting(row) for row in rows if row.state != SubmissionState.RUNNING]
        ordered = in_turn(waiting, owners, self._drives.served, self._drives.slots)
        return {one.id: position for position, one in enumerate(ordered)}

    @property
    def _desks(self) -> tuple[_Desk, _Desk]:
        return self._checks, self._drives

    async def _run(self) -> None:
        while not self._stopping:
            self._changed.clear()
            try:
                await self._look()
            except Exception:
                self._log.exception("submissions are held up")
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LOOK_S if self._availability.on else _PAUSE_S):
                    await self._changed.wait()

    async def _look(self) -> None:
        """End the jobs of submissions that are over, and begin as many as there are places."""
        await self._availability.look_if_due()
        if self._stopping:
            return
        rows = await self._rows.waiting()
        self._telemetry.submissions(Counter(SubmissionState(row.state) for row in rows))
        self._end_cancelled({row.id for row in rows})
        if not self._availability.on or self._stopping:
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

    def _end_cancelled(self, still_open: set[str]) -> None:
        for desk in self._desks:
            for submission, job in desk.jobs.items():
                if submission not in still_open:
                    job.halt.set()

    def _begin(self, desk: _Desk, row: SubmissionRow) -> None:
        if row.state != SubmissionState.RUNNING:
            desk.serve(row.owner_id)
        desk.jobs[row.id] = job = _Job(row)
        job.task = asyncio.create_task(self._work(desk, job))
        job.task.add_done_callback(lambda _task: self._ended(desk, row.id))

    def _ended(self, desk: _Desk, submission: str) -> None:
        del desk.jobs[submission]
        self._changed.set()

    async def _work(self, desk: _Desk, job: _Job) -> None:
        """Check or drive a submission. What goes wrong in the service itself is tried again later."""
        submission = job.row.id
        try:
            now = await self._rows.get(submission)
            if now is None or now.state != job.row.state:
                return  # another job ended with it while the line was read
            await self._carry(desk, job, now)
        except (OverError, HaltedError):
            return
        except Exception:
            self._log.exception("submission is held up", submission=submission)
            with contextlib.suppress(HaltedError):
                await pause(_PAUSE_S, job.halt)

    async def _carry(self, desk: _Desk, job: _Job, row: SubmissionRow) -> None:
        try:
            await desk.work(row, self._url, job.halt)
        except RefusedError as error:
            await self._submissions.end(row.id, SubmissionState.FAILED, str(error))
        else:
            if desk.done is not None:
                await self._submissions.end(row.id, desk.done)


def _waiting(row: SubmissionRow) -> Waiting:
    return Waiting(row.id, row.owner_id, row.seq)
