"""Queries about evaluations."""

import time
from collections.abc import Callable, Sequence

from sqlalchemy import ColumnElement, func, select, update
from sqlalchemy.ext.asyncio import AsyncSession

from wrongturn_protocol import EpisodeState, EvaluationState, Outcome
from wrongturn_service.storage.accounts import check_there
from wrongturn_service.storage.models import (
    AgentRow,
    EpisodeRow,
    EvaluationRow,
    IdempotencyRow,
    ResultsRow,
    UnusedSecretRow,
)
from wrongturn_service.storage.queries import Queries, next_number
from wrongturn_service.storage.usage import ROW, owner_of, size_of
from wrongturn_service.storage.visible import counting_suites, public_evaluations, seen_evaluations


class EvaluationOverError(Exception):
    """The evaluation takes no more episodes or steps: it is finished, cancelled or deleted."""


class EvaluationStore(Queries):
    """Reads and writes evaluations and what workers record of them."""

    async def begin_evaluation(
        self, evaluation: EvaluationRow, remember: Callable[[EvaluationRow], IdempotencyRow | None]
    ) -> EvaluationRow:
        """Store a new evaluation, unless one of the agent on the suite is running.

        It takes the secret of the agent's last evaluation on the suite if that one was deleted before its first step.
        ``remember`` makes the reply for the idempotency key. Returns the one that is running now. Raises
        QuotaReachedError if what it can come to does not fit.
        """
        async with self._database.write() as session:
            of_agent = EvaluationRow.agent_id == evaluation.agent_id, EvaluationRow.suite == evaluation.suite
            running = select(EvaluationRow).where(*of_agent, EvaluationRow.state == EvaluationState.RUNNING)
            found = await session.scalar(running.order_by(EvaluationRow.seq).limit(1))
            if found is not None:
                return found
            await check_there(session, AgentRow, evaluation.agent_id)
            await prepare_evaluation(session, evaluation)
            owner = await owner_of(session, evaluation.agent_id)
            evaluation.stored_bytes = evaluation.stored_bytes or ROW
            await self._usage.take(session, owner, evaluation.stored_bytes, reserve=True)
            session.add(evaluation)
            about = {"agent_id": evaluation.agent_id, "evaluation_id": evaluation.id}
            await self._usage.remember(session, remember(evaluation), owner, about)
        return evaluation

    async def evaluation(self, evaluation_id: str) -> EvaluationRow | None:
        """Return an evaluation, or None."""
        return await self._get(EvaluationRow, evaluation_id)

    async def is_public(self, evaluation_id: str) -> bool:
        """Return whether everybody may see an evaluation: it is finished, and the operator does not hide it."""
        query = select(EvaluationRow.id).where(EvaluationRow.id == evaluation_id, *public_evaluations())
        return await self._one(query) is not None

    async def running_evaluations(self) -> Sequence[EvaluationRow]:
        """Return the evaluations that are neither finished nor cancelled."""
        return await self._all(select(EvaluationRow).where(EvaluationRow.state == EvaluationState.RUNNING))

    async def running_since(self) -> list[tuple[str, float, float]]:
        """Return each running evaluation, when it was begun, and when it last had a reset or an episode's end."""
        query = (
            select(
                EvaluationRow.id,
                EvaluationRow.created,
                func.max(func.coalesce(EpisodeRow.finished, EpisodeRow.created)),
            )
            .outerjoin(EpisodeRow, EpisodeRow.evaluation_id == EvaluationRow.id)
            .where(EvaluationRow.state == EvaluationState.RUNNING)
            .group_by(EvaluationRow.id, EvaluationRow.created)
        )
        rows = await self._rows(query)
        return [(evaluation, created, max(created, active or created)) for evaluation, created, active in rows]

    async def drive_evaluation(self, evaluation_id: str) -> bool:
        """Note an evaluation's first step, before it is taken. Return whether the evaluation is still running."""
        async with self._database.write() as session:
            row = await session.get(EvaluationRow, evaluation_id)
            if row is None or row.state != EvaluationState.RUNNING:
                return False
            if row.driven is None:
                row.driven = time.time()
            return True

    async def finish_evaluation(self, evaluation_id: str, metrics: str, versions: str) -> bool:
        """Store an evaluation's metrics, and by which versions they were made. Return False if it was finished."""
        running = EvaluationRow.id == evaluation_id, EvaluationRow.state == EvaluationState.RUNNING
        values = {"state": EvaluationState.FINISHED, "finished": time.time(), "metrics": metrics, "versions": versions}
        finish = update(EvaluationRow).where(*running).values(**values, stored_bytes=size_of(metrics, versions))
        return bool(await self._write(finish))

    async def delete_undriven(self, evaluation_id: str) -> bool:
        """Delete a running evaluation without any step, and keep its secret for the agent's next one on the suite.

        Returns whether it was deleted.
        """
        async with self._database.write() as session:
            row = await session.get(EvaluationRow, evaluation_id)
            if row is None or row.state != EvaluationState.RUNNING or row.driven is not None:
                return False
            secret = UnusedSecretRow(agent_id=row.agent_id, suite=row.suite, secret=row.secret)
            await session.delete(row)
            await session.merge(secret)
        return True

    async def abort_rest(self, evaluation_id: str, aborted: Sequence[EpisodeRow]) -> None:
        """Give an ``aborted`` episode to every trial of a running evaluation that has no verdict.

        ``aborted`` has a finished episode of each trial and twin.
        """
        async with self._database.write() as session:
            row = await session.get(EvaluationRow, evaluation_id)
            if row is None or row.state != EvaluationState.RUNNING:
                return
            ghosts = update(EpisodeRow).where(
                EpisodeRow.evaluation_id == evaluation_id, EpisodeRow.state == EpisodeState.OPEN
            )
            await session.execute(ghosts.values(state=EpisodeState.LOST, finished=time.time()))
            scored = select(EpisodeRow.trial_id).where(*_scored(evaluation_id))
            done = set((await session.scalars(scored)).all())
            missing = [episode for episode in aborted if episode.trial_id not in done]
            for seq, episode in enumerate(missing, await next_episode(session, evaluation_id)):
                episode.seq = seq
                episode.stored_bytes = size_of(episode.trial, episode.outcome)
            session.add_all(missing)

    async def finished_count(self, evaluation_id: str) -> int:
        """Return how many of an evaluation's episodes have a verdict."""
        return await self._one(select(func.count()).where(*_scored(evaluation_id))) or 0

    async def outcomes(self, evaluation_id: str) -> dict[str, Outcome]:
        """Return the outcomes of an evaluation's finished episodes, by trial id."""
        rows = await self._rows(select(EpisodeRow.trial_id, EpisodeRow.outcome).where(*_scored(evaluation_id)))
        return {trial: Outcome.model_validate_json(outcome) for trial, outcome in rows if outcome is not None}

    async def put_results(self, evaluation_id: str, body: str) -> None:
        """Store a worker's own record. A newer one replaces it. Raises QuotaReachedError."""
        async with self._database.write() as session:
            evaluation = await session.get(EvaluationRow, evaluation_id)
            if evaluation is None:
                return
            size, now = size_of(body), time.time()
            await self._usage.take(session, await owner_of(session, evaluation.agent_id), size)
            await session.merge(ResultsRow(evaluation_id=evaluation_id, body=body, created=now, stored_bytes=size))

    async def cancelled_counts(self, suite: str) -> dict[str, int]:
        """Return how many evaluations of a suite each agent cancelled after it had begun to drive."""
        query = (
            select(EvaluationRow.agent_id, func.count())
            .where(
                EvaluationRow.suite == suite,
                EvaluationRow.state == EvaluationState.CANCELLED,
                EvaluationRow.driven.is_not(None),
            )
            .group_by(EvaluationRow.agent_id)
        )
        return dict(await self._rows(query))

    async def first_finished(self, suite: str) -> list[tuple[EvaluationRow, AgentRow]]:
        """Return the first evaluation that each agent began on a suite and that is finished: the one that counts.

        If the operator hides it, the agent has none.
        """
        query = (
            select(EvaluationRow, AgentRow, seen_evaluations())
            .join(AgentRow, AgentRow.id == EvaluationRow.agent_id)
            .where(EvaluationRow.suite == suite, EvaluationRow.state == EvaluationState.FINISHED, counting_suites())
            .order_by(EvaluationRow.seq)
        )
        first: dict[str, tuple[EvaluationRow, AgentRow, bool]] = {}
        for evaluation, agent, seen in await self._rows(query):
            first.setdefault(agent.id, (evaluation, agent, seen))
        return [(evaluation, agent) for evaluation, agent, seen in first.values() if seen]

    async def finished_summary(self) -> dict[str, tuple[int, float]]:
        """Return for each suite how many agents have finished it, and when the last one did."""
        agents = func.count(EvaluationRow.agent_id.distinct())
        query = (
            select(EvaluationRow.suite, agents, func.max(EvaluationRow.finished))
            .where(*public_evaluations(), counting_suites())
            .group_by(EvaluationRow.suite)
        )
        return {suite: (count, newest or 0.0) for suite, count, newest in await self._rows(query)}

    async def check_room(self, owner_id: str, more: int) -> None:
        """Make room for so many bytes of an owner, if need be by deleting its oldest practice.

        Raises QuotaReachedError if there is none.
        """
        async with self._database.write() as session:
            await self._usage.make_room(session, owner_id, more)


def _scored(evaluation_id: str) -> tuple[ColumnElement[bool], ...]:
    return EpisodeRow.evaluation_id == evaluation_id, EpisodeRow.state == EpisodeState.FINISHED


async def prepare_evaluation(session: AsyncSession, evaluation: EvaluationRow) -> None:
    """Number an evaluation that is about to be stored.

    It takes the secret of the agent's last one on the suite if that was deleted before its first step.
    """
    evaluation.seq = await next_number(session, EvaluationRow.seq)
    unused = await session.get(UnusedSecretRow, (evaluation.agent_id, evaluation.suite))
    if unused is not None:
        evaluation.secret = unused.secret
        await session.delete(unused)


async def next_episode(session: AsyncSession, evaluation_id: str) -> int:
    """Return the number of an evaluation's next episode."""
    return await next_number(session, EpisodeRow.seq, EpisodeRow.evaluation_id == evaluation_id)
