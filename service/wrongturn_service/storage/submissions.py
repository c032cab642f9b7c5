"""All queries about submissions, one method each. Rows are detached: read them, do not change them."""

import time
from collections.abc import Awaitable, Callable, Iterable, Sequence
from typing import Any, Final

from sqlalchemy import and_, delete, exists, func, or_, select, update
from sqlalchemy.ext.asyncio import AsyncSession

from wrongturn_protocol import EpisodeState, EvaluationState, SubmissionState, Verdict
from wrongturn_protocol.vocabulary import Collection
from wrongturn_service.storage import held
from wrongturn_service.storage.accounts import AgentNameTakenError, agent_name_taken, check_there
from wrongturn_service.storage.evaluations import prepare_evaluation
from wrongturn_service.storage.models import (
    AgentRow,
    EpisodeRow,
    EvaluationRow,
    IdempotencyRow,
    OwnerRow,
    SubmissionLogRow,
    SubmissionRow,
    names_of,
)
from wrongturn_service.storage.queries import Queries, next_number
from wrongturn_service.storage.usage import ROW, SUBMISSION, size_of

OPEN: Final = tuple(state for state in SubmissionState if not state.over)
"""States of submissions that wait or run."""
_LONGEST: Final = 4000
"""Characters of a reason or a log's message. Part of them can come from a model."""


class TooManySubmissionsError(Exception):
    """The owner has as many open submissions as one may have."""


class SuiteBegunError(Exception):
    """The agent has an evaluation or an open submission on the suite already."""


class SubmissionOverError(Exception):
    """The submission is over, or is not in the state that the call needs."""


async def _nobody(submission_id: str) -> None:
    """Tell nobody."""


class SubmissionStore(Queries):
    """Reads and writes submissions. Each method is one transaction.

    A runner's token ends whenever its submission changes its state. :attr:`token_ended` is awaited then.
    """

    token_ended: Callable[[str], Awaitable[None]] = staticmethod(_nobody)
    """Awaited with the submission's id after its token has ended, or its agent's id after that was deleted."""

    async def add(self, submission: SubmissionRow, reply: IdempotencyRow | None, *, most: int) -> None:
        """Store a new submission as the last in line. Sets its ``seq``.

        The row is in the state ``queued``. An owner may have ``most`` open ones. If the owner has handed the same model
        in by the same name before, its agent is that one.

        Raises:
            AgentNameTakenError: An agent or an open submission has the name of the agent that is to be made.
            SuiteBegunError: The agent that hands it in has begun the suite.
            TooManySubmissionsError: The owner has as many already.
            QuotaReachedError: The model does not fit.
        """
        async with self._database.write() as session:
            await check_there(session, OwnerRow, submission.owner_id)
            if submission.agent_id is None and (same := await _same_agent(session, submission)) is not None:
                submission.agent_id, submission.track = same
            if submission.agent_id is None:
                await _check_name(session, submission)
                owner = await session.get(OwnerRow, submission.owner_id)
                assert owner is not None
                await self._usage.check_accounts(session, owner, agents=1, owners=0)
                session.expunge(owner)  # the submission brings its own
            else:
                await _check_not_begun(session, submission.agent_id, submission.suite)
            is_open = SubmissionRow.owner_id == submission.owner_id, SubmissionRow.state.in_(OPEN)
            if (await session.scalar(select(func.count()).where(*is_open)) or 0) >= most:
                raise TooManySubmissionsError(submission.owner_id)
            submission.seq = await next_number(session, SubmissionRow.seq)
            submission.stored_bytes = SUBMISSION + submission.size
            await self._usage.take(session, submission.owner_id, submission.stored_bytes)
            session.add(submission)
            await self._usage.remember(session, reply, submission.owner_id, {"submission_id": submission.id})

    async def check_name(self, owner_id: str, name_key: str) -> None:
        """Raise AgentNameTakenError if an agent of another owner, or an open submission of one, has a name."""
        theirs = select(AgentRow.owner_id).where(AgentRow.name_key == name_key)
        waiting = select(SubmissionRow.owner_id).where(
            SubmissionRow.name_key == name_key, SubmissionRow.agent_made, SubmissionRow.state.in_(OPEN)
        )
        if any(owner != owner_id for owner in (*await self._all(theirs), *await self._all(waiting))):
            raise AgentNameTakenError(name_key)

    async def forget_model(self, submission_id: str) -> None:
        """Note that a submission's model was deleted, so its bytes count no more. Safe to call again."""
        await self._write(
            update(SubmissionRow).where(SubmissionRow.id == submission_id).values(stored_bytes=SUBMISSION)
        )

    async def open_count(self, owner_id: str) -> int:
        """Return how many submissions of an owner wait or run."""
        is_open = SubmissionRow.owner_id == owner_id, SubmissionRow.state.in_(OPEN)
        return await self._one(select(func.count()).where(*is_open)) or 0

    async def get(self, submission_id: str) -> SubmissionRow | None:
        """Return a submission, or None."""
        return await self._get(SubmissionRow, submission_id)

    async def by_token(self, token_sha256: str) -> SubmissionRow | None:
        """Return the submission whose runner has this token, or None."""
        return await self._one(select(SubmissionRow).where(SubmissionRow.token_sha256 == token_sha256))

    async def newest(
        self, *, owner: str | None = None, agent: str | None = None, before: int | None = None, limit: int | None = None
    ) -> Sequence[SubmissionRow]:
        """Return submissions, newest first.

        ``before`` is the ``seq`` before which to begin.
        """
        query = select(SubmissionRow).order_by(SubmissionRow.seq.desc()).limit(limit)
        if owner is not None:
            query = query.where(SubmissionRow.owner_id == owner)
        if agent is not None:
            query = query.where(SubmissionRow.agent_id == agent)
        if before is not None:
            query = query.where(SubmissionRow.seq < before)
        return await self._all(query)

    async def waiting(self) -> Sequence[SubmissionRow]:
        """Return the submissions that wait or run in the order of arrival."""
        query = select(SubmissionRow).where(SubmissionRow.state.in_(OPEN)).order_by(SubmissionRow.seq)
        return await self._all(query)

    async def progress(self, evaluation_ids: Iterable[str]) -> dict[str, tuple[int, int]]:
        """Return how many episodes of each of some hundred evaluations were driven to their end, and how many it has.

        The trials that are missing when an evaluation is closed get a verdict too, but nobody drove them.
        """
        finished = and_(
            EpisodeRow.evaluation_id == EvaluationRow.id,
            EpisodeRow.state == EpisodeState.FINISHED,
            EpisodeRow.verdict != Verdict.ABORTED,
        )
        query = (
            select(EvaluationRow.id, func.count(EpisodeRow.id), EvaluationRow.trials)
            .outerjoin(EpisodeRow, finished)
            .where(EvaluationRow.id.in_(evaluation_ids))
            .group_by(EvaluationRow.id, EvaluationRow.trials)
        )
        return {name: (done, episodes) for name, done, episodes in await self._rows(query)}

    async def last_served(self) -> dict[str, int]:
        """Return the turn in which the last submission of each owner and address began to run, by their names.

        A turn is the number of the submission's evaluation. Names that were never served are left out.
        """
        turn = func.max(EvaluationRow.seq)
        query = (
            select(OwnerRow.id, OwnerRow.origin, turn)
            .join(SubmissionRow, SubmissionRow.owner_id == OwnerRow.id)
            .join(EvaluationRow, EvaluationRow.id == SubmissionRow.evaluation_id)
            .group_by(OwnerRow.id, OwnerRow.origin)
            .order_by(turn)  # of an address, its last owner's stays
        )
        return {name: turn for owner, origin, turn in await self._rows(query) for name in names_of(owner, origin)}

    async def turns(self) -> dict[str, int]:
        """Return the turn in which each submission that runs has begun, by its id."""
        query = (
            select(SubmissionRow.id, EvaluationRow.seq)
            .join(EvaluationRow, EvaluationRow.id == SubmissionRow.evaluation_id)
            .where(SubmissionRow.state == SubmissionState.RUNNING)
        )
        return dict(await self._rows(query))

    async def set_state(
        self, submission_id: str, state: SubmissionState, *, reason: str | None = None, **columns: Any
    ) -> bool:
        """Move a submission into a state, and end its runner's token unless a new one is among the columns.

        A submission that is over stays as it is. ``started`` is set when it first runs, ``ended`` when it is over.
        Returns whether it has changed.
        """
        now = time.time()
        values: dict[str, Any] = {"token_sha256": None, **columns, "state": state, "reason": storable(reason)}
        if state is SubmissionState.RUNNING:
            values["started"] = func.coalesce(SubmissionRow.started, now)
        if state.over:
            values["ended"] = now
        return await self._change(submission_id, values, ends_token=True)

    async def set_columns(self, submission_id: str, **columns: Any) -> bool:
        """Change columns of a submission that is not over. Returns whether it has changed."""
        ends_token = not columns.keys().isdisjoint({"token_sha256", "evaluation_id", "agent_id"})
        return await self._change(submission_id, columns, ends_token=ends_token)

    async def _change(self, submission_id: str, values: dict[str, Any], *, ends_token: bool) -> bool:
        is_open = SubmissionRow.id == submission_id, SubmissionRow.state.in_(OPEN)
        changed = bool(await self._write(update(SubmissionRow).where(*is_open).values(**values)))
        if changed and ends_token:
            await self.token_ended(submission_id)
        return changed

    async def make_agent(self, submission_id: str, agent: AgentRow) -> None:
        """Store the agent of a submission that is being checked, unless the same model made it meanwhile.

        Raises:
            SubmissionOverError: The submission is not ``queued`` any more, or has an agent.
            AgentNameTakenError: Another agent has the name.
        """
        async with self._database.write() as session:
            row = await session.get(SubmissionRow, submission_id)
            if row is None or row.state != SubmissionState.QUEUED or row.agent_id is not None:
                raise SubmissionOverError(submission_id)
            if (same := await _same_agent(session, row)) is not None:
                row.agent_id, row.track = same
                return
            if await agent_name_taken(session, agent.name_key):
                raise AgentNameTakenError(agent.name)
            agent.stored_bytes = size_of(agent.description)
            await self._usage.add(session, row.owner_id, agent.stored_bytes)
            session.add(agent)
            await session.flush()
            row.agent_id, row.track = agent.id, agent.track

    async def remove_agent(self, submission_id: str) -> str | None:
        """Delete the agent that was made for a submission, and its practice, unless it has an evaluation.

        One that another open submission of the same model needs stays too.

        Returns the id of the agent that was deleted, or None.
        """
        async with self._database.write() as session:
            row = await session.get(SubmissionRow, submission_id)
            if row is None or not row.agent_made or row.agent_id is None:
                return None
            agent = row.agent_id
            begun = select(EvaluationRow.id).where(EvaluationRow.agent_id == agent).limit(1)
            others = SubmissionRow.agent_id == agent, SubmissionRow.id != row.id, SubmissionRow.state.in_(OPEN)
            needed = select(SubmissionRow.id).where(*others).limit(1)
            if await session.scalar(begun) is not None or await session.scalar(needed) is not None:
                return None
            await session.execute(delete(AgentRow).where(AgentRow.id == agent))
        return agent

    async def begin_evaluation(self, submission_id: str, evaluation: EvaluationRow) -> None:
        """Store the evaluation of a submission that is ``checked``, and move the submission to ``running``.

        Raises:
            SubmissionOverError: The submission is not ``checked`` any more.
            SuiteBegunError: The agent has an evaluation on the suite already.
        """
        async with self._database.write() as session:
            row = await session.get(SubmissionRow, submission_id)
            if row is None or row.state != SubmissionState.CHECKED:
                raise SubmissionOverError(submission_id)
            await _check_no_evaluation(session, evaluation.agent_id, evaluation.suite)
            await prepare_evaluation(session, evaluation)
            # It is not refused: the submission was taken in, and the service itself drives it.
            evaluation.stored_bytes = evaluation.stored_bytes or ROW
            await self._usage.add(session, row.owner_id, evaluation.stored_bytes)
            session.add(evaluation)
            await session.flush()
            row.evaluation_id, row.state, row.started = evaluation.id, SubmissionState.RUNNING.value, time.time()

    async def half_ended(self) -> Sequence[SubmissionRow]:
        """Return the submissions that failed or were cancelled, but whose evaluation is open or whose agent is there.

        The service died before it could close the one and delete the other.
        """
        running = (
            select(EvaluationRow.id)
            .where(EvaluationRow.id == SubmissionRow.evaluation_id, EvaluationRow.state == EvaluationState.RUNNING)
            .exists()
        )
        begun = select(EvaluationRow.id).where(EvaluationRow.agent_id == SubmissionRow.agent_id).exists()
        made = and_(SubmissionRow.agent_made, SubmissionRow.agent_id.is_not(None), ~begun)
        ended = SubmissionRow.state.in_((SubmissionState.FAILED, SubmissionState.CANCELLED))
        return await self._all(select(SubmissionRow).where(ended, or_(running, made)).order_by(SubmissionRow.seq))

    async def append_log(self, submission_id: str, message: str) -> None:
        """Add a line to a submission's log, unless the submission was deleted."""
        async with self._database.write() as session:
            if await session.get(SubmissionRow, submission_id) is None:
                return
            of_it = SubmissionLogRow.submission_id == submission_id
            number = await next_number(session, SubmissionLogRow.number, of_it)
            text = storable(message) or ""
            session.add(SubmissionLogRow(submission_id=submission_id, number=number, time=time.time(), message=text))

    async def log(self, submission_id: str) -> Sequence[SubmissionLogRow]:
        """Return a submission's log, oldest line first."""
        query = select(SubmissionLogRow).where(SubmissionLogRow.submission_id == submission_id)
        return await self._all(query.order_by(SubmissionLogRow.number))

    async def purge_logs(self, before: float) -> None:
        """Delete the logs of submissions that were over before a time, seconds since 1970."""
        old = select(SubmissionRow.id).where(SubmissionRow.ended < before)
        await self._write(delete(SubmissionLogRow).where(SubmissionLogRow.submission_id.in_(old)))

    async def some(self, submission_ids: Iterable[str]) -> Sequence[SubmissionRow]:
        """Return these submissions. Unknown ids are left out."""
        async with self._database.read() as session:
            found = [await session.get(SubmissionRow, submission_id) for submission_id in submission_ids]
        return [row for row in found if row is not None]


async def _same_agent(session: AsyncSession, submission: SubmissionRow) -> tuple[str, str] | None:
    """Return id and track of the agent as which the owner has handed the same model in by the same name, or None."""
    same = SubmissionRow.agent_id == AgentRow.id, SubmissionRow.sha256 == submission.sha256, SubmissionRow.agent_made
    by_name = AgentRow.name_key == submission.name_key, AgentRow.owner_id == submission.owner_id
    found = (await session.execute(select(AgentRow.id, AgentRow.track).where(*by_name, exists().where(*same)))).first()
    return None if found is None else (found.id, found.track)


async def _check_name(session: AsyncSession, submission: SubmissionRow) -> None:
    """Raise AgentNameTakenError unless only the same model waits by this name, for other suites of the same owner."""
    same = (
        SubmissionRow.owner_id == submission.owner_id,
        SubmissionRow.sha256 == submission.sha256,
        SubmissionRow.suite != submission.suite,
    )
    handed_in = SubmissionRow.name_key == submission.name_key, SubmissionRow.agent_made, SubmissionRow.state.in_(OPEN)
    taken = select(SubmissionRow.id).where(*handed_in, ~and_(*same)).limit(1)
    if await agent_name_taken(session, submission.name_key) or await session.scalar(taken) is not None:
        raise AgentNameTakenError(submission.name)


async def _check_not_begun(session: AsyncSession, agent_id: str, suite: str) -> None:
    if await held.is_held(session, Collection.EVALUATIONS, held.place(agent_id, suite)):
        raise SuiteBegunError(agent_id)
    await _check_no_evaluation(session, agent_id, suite)
    of_agent = SubmissionRow.agent_id == agent_id, SubmissionRow.suite == suite
    waiting = select(SubmissionRow.id).where(*of_agent, SubmissionRow.state.in_(OPEN))
    if await session.scalar(waiting.limit(1)) is not None:
        raise SuiteBegunError(agent_id)


async def _check_no_evaluation(session: AsyncSession, agent_id: str, suite: str) -> None:
    begun = select(EvaluationRow.id).where(EvaluationRow.agent_id == agent_id, EvaluationRow.suite == suite)
    if await session.scalar(begun.limit(1)) is not None:
        raise SuiteBegunError(agent_id)


def storable(text: str | None) -> str | None:
    """Return a text that every database takes: cut, and without NUL characters and lone surrogates."""
    if text is None:
        return None
    return text[:_LONGEST].replace("\0", "\ufffd").encode("utf-8", "replace").decode()
