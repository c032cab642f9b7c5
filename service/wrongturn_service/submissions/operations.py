"""What is done with submissions: taking them in, giving their runners tokens, and ending them."""

import asyncio
import contextlib
import time
from collections.abc import Callable, Iterable
from typing import Final
from weakref import WeakValueDictionary

import structlog
from sqlalchemy.exc import SQLAlchemyError

from wrongturn_protocol import AgentKind, FieldError, ProblemType, Rig, SubmissionState, Track
from wrongturn_protocol.submissions import NAME, SUITE
from wrongturn_service.episodes.episodes import Episodes
from wrongturn_service.episodes.resets import Closings
from wrongturn_service.errors import ConflictError, ServiceError, UnavailableError, too_many
from wrongturn_service.settings import Settings
from wrongturn_service.storage.accounts import AgentNameTakenError
from wrongturn_service.storage.models import AgentRow, IdempotencyRow, SubmissionRow
from wrongturn_service.storage.submissions import (
    SubmissionOverError,
    SubmissionStore,
    SuiteBegunError,
    TooManySubmissionsError,
)
from wrongturn_service.submissions.files import ModelFiles, never_driven
from wrongturn_service.telemetry import Telemetry
from wrongturn_service.tokens import digest, new_id, new_token

_DAY_S: Final = 86400.0
_COME_BACK_S: Final = 60
_PATIENCE_S: Final = 10.0
NO_MODEL: Final = "the service no longer has the model: backups do not hold models; hand it in again"


class RefusedError(Exception):
    """The submission has failed. The message says why and what to do, for its owner."""


class OverError(Exception):
    """The submission is over: it was cancelled while it was checked or driven."""


class Submissions:
    """Submissions with their models, agents and tokens.

    Attributes:
        rows: The database.
        files: The models.
        changed: Called whenever a submission was handed in or is over. The dispatcher looks at the line then.
    """

    def __init__(
        self,
        rows: SubmissionStore,
        files: ModelFiles,
        episodes: Episodes,
        closings: Closings,
        settings: Settings,
        telemetry: Telemetry,
    ) -> None:
        self.rows = rows
        self.files = files
        self.changed: Callable[[], None] = lambda: None
        self._episodes = episodes
        self._closings = closings
        self._settings = settings
        self._telemetry = telemetry
        # Each exists while somebody holds it or waits for it.
        self._ending: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()
        self._log = structlog.get_logger("submissions")

    async def add(self, row: SubmissionRow, reply: IdempotencyRow | None) -> None:
        """Store a submission whose model is on disk, as the last in line. If it is refused, its model is deleted.

        Raises ConflictError if the name is taken or the agent has begun the suite, UnavailableError (429) if the owner
        has too many open submissions.
        """
        try:
            await self.rows.add(row, reply, most=self._settings.submissions_per_owner)
        except Exception as error:
            # A commit may have succeeded before its connection broke. Then the row needs its model.
            if not isinstance(error, SQLAlchemyError) or await self.rows.get(row.id) is None:
                await asyncio.to_thread(self.files.delete, row.id)
            if isinstance(error, AgentNameTakenError | SuiteBegunError | TooManySubmissionsError):
                raise _refused(row, error) from error
            raise
        self._log.info("submission handed in", submission=row.id, suite=row.suite, size=row.size)
        await self.rows.append_log(row.id, f"Handed in: {row.size} bytes, SHA-256 {row.sha256}")
        self.changed()

    async def check_name(self, owner_id: str, name: str) -> None:
        """Check that an agent of somebody else has not this name. Raises ConflictError."""
        try:
            await self.rows.check_name(owner_id, name.lower())
        except AgentNameTakenError as error:
            raise _name_taken(name) from error

    async def check_room(self, owner_id: str) -> None:
        """Check that an owner may have one more open submission. Raises UnavailableError (429)."""
        if await self.rows.open_count(owner_id) >= self._settings.submissions_per_owner:
            raise _too_many()

    async def give_token(self, submission_id: str) -> str:
        """Return a new token for a submission's runner. The last one ends. Raises OverError.

        While the submission is ``queued`` the token is good for practice. While it is ``running``, the token is good
        for its evaluation.
        """
        token = new_token()
        if not await self.rows.set_columns(submission_id, token_sha256=digest(token)):
            raise OverError(submission_id)
        return token

    async def make_agent(
        self,
        submission_id: str,
        track: Track,
        description: str | None = None,
        *,
        trained_on_faults: bool = False,
        rig: Rig | None = None,
    ) -> None:
        """Make the agent of a submission whose model was looked at, unless an agent handed it in.

        Raises OverError, and RefusedError if the name is taken by now.
        """
        row = await self.rows.get(submission_id)
        if row is None or SubmissionState(row.state).over:
            raise OverError(submission_id)
        if row.agent_id is not None:
            return
        agent = AgentRow(
            id=new_id("ag"),
            name=row.name,
            name_key=row.name_key,
            track=track.value,
            rig=rig and rig.text,
            kind=AgentKind.SUBMITTED.value,
            description=description,
            trained_on_faults=trained_on_faults,
            owner_id=row.owner_id,
            created=time.time(),
        )
        try:
            await self.rows.make_agent(submission_id, agent)
        except SubmissionOverError as error:
            raise OverError(submission_id) from error
        except AgentNameTakenError as error:
            raise RefusedError(
                f"name: {row.name!r} was registered meanwhile by somebody else; hand the model in by another name"
            ) from error

    async def end(self, submission_id: str, state: SubmissionState, reason: str | None = None) -> bool:
        """End a submission: its token ends, its evaluation is closed unless it is finished, its practice is given up.

        An agent that was made for it and never began an evaluation is deleted, so its name is free again. The model
        of a submission without an evaluation is deleted too: its row and log stay. Safe to call again. If it fails
        half-way, :meth:`tidy` and :meth:`purge` go on with it. Returns False if it was over before.
        """
        async with self._ending.setdefault(submission_id, asyncio.Lock()):
            changed = await self.rows.set_state(submission_id, state, reason=reason)
            if changed:
                words = f"{state.capitalize()}." if reason is None else f"{state.capitalize()}: {reason}"
                await self.rows.append_log(submission_id, words)
                self.note_end(submission_id, state, reason)
            row = await self.rows.get(submission_id)
            if row is not None:
                await self._clean_up(row)
            return changed

    def note_end(self, submission_id: str, state: SubmissionState, reason: str | None = None) -> None:
        """Log and count the end of a submission, which the database has already, and let the dispatcher look."""
        self._log.info("submission over", submission=submission_id, state=state.value, reason=reason)
        self._telemetry.submissions_over.labels(state.value).inc()
        self.changed()

    async def settled(self, submission_ids: Iterable[str]) -> None:
        """Wait until submissions that are just being ended have left nothing behind.

        Otherwise somebody who reads that one has failed would find its evaluation open, or its agent's name taken.
        """
        ending = [lock for submission_id in submission_ids if (lock := self._ending.get(submission_id)) is not None]
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_PATIENCE_S):
                for lock in ending:
                    async with lock:
                        pass

    async def _clean_up(self, row: SubmissionRow) -> None:
        if row.evaluation_id is not None:
            await self._closings.close(row.evaluation_id)
        await self._episodes.lose(row.id)
        agent = await self.rows.remove_agent(row.id)
        if agent is not None:
            # Its owner may have made a token for it.
            await self.rows.token_ended(agent)
            await self._episodes.lose(agent)
        # Closed before its first step, an evaluation is gone by now.
        left = await self.rows.get(row.id)
        if left is not None and never_driven(left):
            await asyncio.to_thread(self.files.delete, row.id)
            await self.rows.forget_model(row.id)

    async def tidy(self) -> None:
        """Finish clean-up that a stop or a failure interrupted. Call it before the first runner.

        Submissions that are over are cleaned up. Those that wait or run without a model have failed. Practice of
        checks is gone, as all open episodes are.
        """
        for row in await self.rows.half_ended():
            await self._clean_up(row)
        for row in await self.rows.waiting():
            if not await asyncio.to_thread(self.files.path(row.id).is_file):
                await self.end(row.id, SubmissionState.FAILED, NO_MODEL)

    async def evaluations(self) -> set[str]:
        """Return the evaluations that the service drives itself, or will go on with."""
        rows = [row for row in await self.rows.waiting() if row.state == SubmissionState.RUNNING]
        return {row.evaluation_id for row in rows if row.evaluation_id is not None}

    async def purge(self) -> None:
        """Delete the models and logs of submissions that were over long ago, and models that were never driven."""
        before = time.time() - self._settings.submission_keep_days * _DAY_S
        await self.rows.purge_logs(before)
        deleted = await self.files.purge(self.rows, before)
        if deleted:
            self._log.info("models deleted", count=deleted, days=self._settings.submission_keep_days)


def _refused(row: SubmissionRow, error: Exception) -> ServiceError:
    if isinstance(error, TooManySubmissionsError):
        return _too_many()
    if isinstance(error, AgentNameTakenError):
        return _name_taken(row.name)
    message = (
        f"agent {row.name!r} has begun {row.suite}, and its first evaluation counts; hand a new model in as a new "
        "agent, with its owner's token and another name"
    )
    return ConflictError(
        ProblemType.EVALUATION_OPEN, f"suite: {message}", errors=[FieldError(path=SUITE, message=message)]
    )


def _name_taken(name: str) -> ConflictError:
    message = f"{name!r} is taken by an agent or a submission; choose another (a new model is a new agent)"
    return ConflictError(
        ProblemType.AGENT_NAME_TAKEN, f"name: {message}", errors=[FieldError(path=NAME, message=message)]
    )


def _too_many() -> UnavailableError:
    detail = "this owner has as many open submissions as it may have; wait for one to end, or DELETE one"
    return too_many(detail, retry_after_s=_COME_BACK_S)
