"""What checks and drives of submissions have in common."""

import asyncio
import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import structlog

from wrongturn_protocol import SubmissionState
from wrongturn_runner.messages import Place
from wrongturn_service.episodes.evaluations import RunningEvaluations
from wrongturn_service.episodes.manager import EpisodeManager
from wrongturn_service.episodes.openings import PATIENCE_S
from wrongturn_service.settings import Settings
from wrongturn_service.storage.models import SubmissionRow
from wrongturn_service.storage.store import Store
from wrongturn_service.submissions.availability import Availability
from wrongturn_service.submissions.errors import HaltedError, OverError, RefusedError
from wrongturn_service.submissions.operations import NO_MODEL, Submissions
from wrongturn_service.submissions.runners import NoRoomError, RunnerLostError
from wrongturn_service.telemetry import Telemetry

ATTEMPTS: Final = 5
"""Runners in a row that may end before they have done anything."""
_FIRST_PAUSE_S: Final = 0.25
_LONGEST_PAUSE_S: Final = 5.0
_LOOK_S: Final = 3.0


@dataclass(frozen=True)
class Means:
    """Parts of the service that a job uses."""

    settings: Settings
    store: Store
    submissions: Submissions
    episodes: EpisodeManager
    evaluations: RunningEvaluations
    availability: Availability
    telemetry: Telemetry
    command: Sequence[str]
    """Program of a runner."""

    @property
    def place(self) -> Place:
        """Where the sandboxes are."""
        return Place(socket=self.settings.runner_socket, memory=self.settings.model_memory)

    def model(self, row: SubmissionRow) -> Path:
        """Return the file with a submission's model. Raises RefusedError if it is gone."""
        file = self.submissions.files.path(row.id)
        if not file.is_file():
            raise RefusedError(NO_MODEL)
        return file

    async def tell(self, submission: str, message: str) -> None:
        """Add a line to a submission's log, for its owner."""
        await self.submissions.rows.append_log(submission, message)

    async def _tell_once(self, submission: str, message: str) -> None:
        """Add a line to a submission's log unless it is the last one: waiting can take long."""
        lines = await self.submissions.rows.log(submission)
        if not lines or lines[-1].message != message:
            await self.tell(submission, message)

    async def token(self, submission: str) -> str:
        """Return a new token for a submission's runner. Raises OverError if the submission is over."""
        token = await self.submissions.give_token(submission)
        if token is None:
            raise OverError(submission)
        return token

    async def sandboxes(self, submission: str, halt: asyncio.Event) -> None:
        """Wait until there are sandboxes. Raises HaltedError."""
        if self.availability.on:
            return
        await self._tell_once(submission, "The service has no sandbox at the moment. It goes on as soon as it has one.")
        while not await self.availability.look():
            await pause(_LOOK_S, halt)

    async def runner_gone(self, submission: str, patience_s: float = PATIENCE_S) -> None:
        """End the token of a runner that is gone, and give up its open episodes.

        Args:
            submission: Id of the submission.
            patience_s: Seconds to wait for its resets in progress.
        """
        await self.submissions.rows.set_columns(submission, token_sha256=None)
        await self.episodes.lose(submission, patience_s)

    async def lost(self, row: SubmissionRow, lost: RunnerLostError, attempts: int, halt: asyncio.Event) -> None:
        """Note that a runner was lost, and wait a little before the next one.

        Args:
            row: The submission.
            lost: What happened.
            attempts: How many runners in a row were lost now. One that got no sandbox is none of them.
            halt: Tells the job to end.

        Raises:
            RefusedError: They were too many, or the model is gone, which is why the runner ended.
            OverError: The submission is over, which may be why.
            HaltedError: The job was told to end.
        """
        if not await self.submissions.rows.set_columns(row.id, attempts=attempts):
            raise OverError(row.id)
        self.model(row)
        if isinstance(lost, NoRoomError):
            await self._tell_once(row.id, "All sandboxes are taken. It goes on as soon as one is free.")
            await pause(_LONGEST_PAUSE_S, halt)
            return
        self.telemetry.runners_lost.inc()
        log = structlog.get_logger("submissions")
        log.warning("runner lost", submission=row.id, reason=str(lost), attempts=attempts)
        if attempts >= ATTEMPTS:
            what = "check" if row.state == SubmissionState.QUEUED else "drive"
            raise RefusedError(
                f"the service could not {what} it: {attempts} runners in a row ended before they were done, the last "
                f"one because {lost}; as far as the service can tell, the model is not to blame; ask the operator"
            )
        await self.tell(row.id, f"A runner was lost: {lost}. Runner {attempts + 1} of at most {ATTEMPTS} takes over.")
        await self.availability.look()
        await pause(min(_LONGEST_PAUSE_S, _FIRST_PAUSE_S * 2 ** (attempts - 1)), halt)


async def pause(seconds: float, halt: asyncio.Event) -> None:
    """Wait some seconds. Raises HaltedError as soon as the job is told to end."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await halt.wait()
    if halt.is_set():
        raise HaltedError("the job has to end")
