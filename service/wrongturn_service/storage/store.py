"""Every query of the service, one method each. Rows come back detached: they are read, never changed in place."""

import asyncio
import hashlib
import time
import zlib
from collections.abc import Sequence
from typing import Any

from sqlalchemy import delete, func, select, update
from sqlalchemy.exc import IntegrityError, SQLAlchemyError
from sqlalchemy.ext.asyncio import AsyncSession

from wrongturn_protocol import EpisodeState, EvaluationState, Outcome, Verdict
from wrongturn_service.storage.database import Database
from wrongturn_service.storage.models import (
    AgentRow,
    EpisodeRow,
    EvaluationRow,
    IdempotencyRow,
    ResultsRow,
    TrajectoryRow,
)


class NameTakenError(Exception):
    """Another agent has the name."""


class DamagedTrajectoryError(SQLAlchemyError):
    """What is stored is not what was written: the disk's fault, or somebody's hand."""


class Store:
    """Reads and writes; each method is one transaction.

    What creates something takes the reply to keep for its idempotency key, so that both are stored or neither is.
    """

    def __init__(self, database: Database) -> None:
        self._database = database

    async def ping(self) -> None:
        """Touch the database; raises SQLAlchemy's errors where it does not answer, or is another service's by now."""
        self._database.check()
        async with self._database.read() as session:
            await session.execute(select(1))

    # Agents

    async def add_agent(self, agent: AgentRow, reply: IdempotencyRow | None) -> None:
        """Raises NameTakenError."""
        try:
            async with self._database.write() as session:
                _add(session, agent, reply)
        except IntegrityError as error:
            raise NameTakenError(agent.name) from error

    async def agents(self) -> Sequence[AgentRow]:
        """All, by name."""
        async with self._database.read() as session:
            return (await session.scalars(select(AgentRow).order_by(AgentRow.name_key))).all()

    async def agent(self, agent_id: str) -> AgentRow | None:
        """One agent, or None."""
        async with self._database.read() as session:
            return await session.get(AgentRow, agent_id)

    async def agent_by_token(self, token_sha256: str) -> AgentRow | None:
        """Whose token it is, or None."""
        async with self._database.read() as session:
            return await session.scalar(select(AgentRow).where(AgentRow.token_sha256 == token_sha256))

    async def set_token(self, agent_id: str, token_sha256: str | None, reply: IdempotencyRow | None = None) -> None:
        """Replace an agent's token, or revoke it."""
        async with self._database.write() as session:
            await session.execute(update(AgentRow).where(AgentRow.id == agent_id).values(token_sha256=token_sha256))
            _add(session, reply)

    # Evaluations

    async def add_evaluation(self, evaluation: EvaluationRow, reply: IdempotencyRow | None) -> None:
        """A new evaluation."""
        async with self._database.write() as session:
            _add(session, evaluation, reply)

    async def evaluation(self, evaluation_id: str) -> EvaluationRow | None:
        """One evaluation, or None."""
        async with self._database.read() as session:
            return await session.get(EvaluationRow, evaluation_id)

    async def running_evaluations(self) -> Sequence[EvaluationRow]:
        """Those that are neither finished nor cancelled."""
        async with self._database.read() as session:
            query = select(EvaluationRow).where(EvaluationRow.state == EvaluationState.RUNNING)
            return (await session.scalars(query)).all()

    async def running_count(self, agent_id: str) -> int:
        """How many of an agent's evaluations are neither finished nor cancelled."""
        async with self._database.read() as session:
            query = select(func.count()).where(
                EvaluationRow.agent_id == agent_id,
                EvaluationRow.state == EvaluationState.RUNNING,
            )
            return await session.scalar(query) or 0

    async def finish_evaluation(self, evaluation_id: str, metrics: str) -> None:
        """Store the metrics; a cancelled one stays cancelled."""
        async with self._database.write() as session:
            query = update(EvaluationRow).where(
                EvaluationRow.id == evaluation_id,
                EvaluationRow.state == EvaluationState.RUNNING,
            )
            await session.execute(query.values(state=EvaluationState.FINISHED, finished=time.time(), metrics=metrics))

    async def cancel_evaluation(self, evaluation_id: str) -> None:
        """Cancel it; its open episodes are lost."""
        async with self._database.write() as session:
            query = update(EvaluationRow).where(
                EvaluationRow.id == evaluation_id,
                EvaluationRow.state == EvaluationState.RUNNING,
            )
            await session.execute(query.values(state=EvaluationState.CANCELLED, finished=time.time()))
            lost = update(EpisodeRow).where(
                EpisodeRow.evaluation_id == evaluation_id,
                EpisodeRow.state == EpisodeState.OPEN,
            )
            await session.execute(lost.values(state=EpisodeState.LOST, finished=time.time()))

    async def finished_count(self, evaluation_id: str) -> int:
        """How many of its episodes have their verdict."""
        async with self._database.read() as session:
            query = select(func.count()).where(
                EpisodeRow.evaluation_id == evaluation_id,
                EpisodeRow.state == EpisodeState.FINISHED,
            )
            return await session.scalar(query) or 0

    async def outcomes(self, evaluation_id: str) -> dict[str, Outcome]:
        """By trial id, of those that have their verdict."""
        async with self._database.read() as session:
            query = select(EpisodeRow.trial_id, EpisodeRow.outcome).where(
                EpisodeRow.evaluation_id == evaluation_id,
                EpisodeRow.state == EpisodeState.FINISHED,
            )
            rows = (await session.execute(query)).all()
        return {trial: Outcome.model_validate_json(outcome) for trial, outcome in rows if outcome is not None}

    async def put_results(self, evaluation_id: str, body: str) -> None:
        """Keep a worker's own record; a newer one takes its place."""
        async with self._database.write() as session:
            await session.merge(ResultsRow(evaluation_id=evaluation_id, body=body, created=time.time()))

    async def cancelled_counts(self, suite: str) -> dict[str, int]:
        """How many evaluations on a suite each agent began to drive and then cancelled."""
        driven = select(EpisodeRow.evaluation_id).where(EpisodeRow.evaluation_id == EvaluationRow.id).exists()
        query = (
            select(EvaluationRow.agent_id, func.count())
            .where(EvaluationRow.suite == suite, EvaluationRow.state == EvaluationState.CANCELLED, driven)
            .group_by(EvaluationRow.agent_id)
        )
        async with self._database.read() as session:
            return dict((await session.execute(query)).tuples().all())

    async def first_finished(self, suite: str) -> Sequence[tuple[EvaluationRow, AgentRow]]:
        """Each agent's first finished evaluation on a suite, which is the one that counts."""
        async with self._database.read() as session:
            query = (
                select(EvaluationRow, AgentRow)
                .join(AgentRow, AgentRow.id == EvaluationRow.agent_id)
                .where(EvaluationRow.suite == suite, EvaluationRow.state == EvaluationState.FINISHED)
                .order_by(EvaluationRow.finished, EvaluationRow.id)
            )
            rows = (await session.execute(query)).all()
        first: dict[str, tuple[EvaluationRow, AgentRow]] = {}
        for evaluation, agent in rows:
            first.setdefault(agent.id, (evaluation, agent))
        return list(first.values())

    async def finished_summary(self) -> dict[str, tuple[int, float]]:
        """By suite: how many agents have finished it, and when the newest did."""
        async with self._database.read() as session:
            query = (
                select(
                    EvaluationRow.suite,
                    func.count(EvaluationRow.agent_id.distinct()),
                    func.max(EvaluationRow.finished),
                )
                .where(EvaluationRow.state == EvaluationState.FINISHED)
                .group_by(EvaluationRow.suite)
            )
            rows = (await session.execute(query)).all()
        return {suite: (count, newest or 0.0) for suite, count, newest in rows}

    # Episodes

    async def add_episode(self, episode: EpisodeRow, reply: IdempotencyRow | None) -> None:
        """An episode that was opened; one of the same trial that nobody got to know of is lost by it.

        Raises:
            IntegrityError: the trial has its verdict in this evaluation.
        """
        async with self._database.write() as session:
            if episode.evaluation_id is not None:
                # A commit whose answer was lost with the connection: the service took it for undone, and it was not.
                ghost = update(EpisodeRow).where(
                    EpisodeRow.evaluation_id == episode.evaluation_id,
                    EpisodeRow.trial_id == episode.trial_id,
                    EpisodeRow.state == EpisodeState.OPEN,
                )
                await session.execute(ghost.values(state=EpisodeState.LOST, finished=time.time()))
            _add(session, episode, reply)

    async def episode(self, episode_id: str) -> EpisodeRow | None:
        """One episode, or None."""
        async with self._database.read() as session:
            return await session.get(EpisodeRow, episode_id)

    async def episodes(self, evaluation_id: str, state: EpisodeState | None = None) -> Sequence[EpisodeRow]:
        """An evaluation's, by the time of their reset."""
        async with self._database.read() as session:
            query = select(EpisodeRow).where(EpisodeRow.evaluation_id == evaluation_id)
            if state is not None:
                query = query.where(EpisodeRow.state == state)
            return (await session.scalars(query.order_by(EpisodeRow.created, EpisodeRow.id))).all()

    async def trials_by_state(self, evaluation_id: str) -> dict[EpisodeState, set[str]]:
        """Which of an evaluation's trials are finished and which are open."""
        async with self._database.read() as session:
            query = select(EpisodeRow.state, EpisodeRow.trial_id).where(EpisodeRow.evaluation_id == evaluation_id)
            rows = (await session.execute(query)).all()
        found: dict[EpisodeState, set[str]] = {state: set() for state in EpisodeState}
        for state, trial in rows:
            found[EpisodeState(state)].add(trial)
        return found

    async def finish_episode(self, episode_id: str, values: dict[str, Any], trajectory: bytes, sha256: str) -> bool:
        """Store a verdict with its trajectory; False where the episode was given up or has ended otherwise.

        It can be called again where it is not known what came of it: the same end is stored once.

        Args:
            episode_id: which.
            values: columns of the episode's row.
            trajectory: canonical JSON, or nothing where there is none.
            sha256: of the trajectory.
        """
        # A journey's among other road users has megabytes; other agents' steps go on meanwhile.
        compressed = await asyncio.to_thread(zlib.compress, trajectory, 6)
        async with self._database.write() as session:
            query = update(EpisodeRow).where(EpisodeRow.id == episode_id, EpisodeRow.state == EpisodeState.OPEN)
            result = await session.execute(
                query.values(state=EpisodeState.FINISHED, finished=time.time(), **values),
            )
            if not getattr(result, "rowcount", 0):
                row = await session.get(EpisodeRow, episode_id)
                return (
                    row is not None
                    and row.state == EpisodeState.FINISHED
                    and all(getattr(row, name) == value for name, value in values.items())
                )
            if trajectory:
                session.add(
                    TrajectoryRow(episode_id=episode_id, sha256=sha256, size=len(trajectory), data=compressed),
                )
        return True

    async def lose_episode(self, episode_id: str, verdict: Verdict | None = None) -> None:
        """An open episode is gone; its trial runs anew."""
        async with self._database.write() as session:
            query = update(EpisodeRow).where(EpisodeRow.id == episode_id, EpisodeRow.state == EpisodeState.OPEN)
            await session.execute(query.values(state=EpisodeState.LOST, finished=time.time(), verdict=verdict))

    async def lose_open_episodes(self) -> int:
        """Those that were open when the service ended last; how many there were."""
        async with self._database.write() as session:
            query = update(EpisodeRow).where(EpisodeRow.state == EpisodeState.OPEN)
            result = await session.execute(query.values(state=EpisodeState.LOST, finished=time.time()))
            return int(getattr(result, "rowcount", 0))

    async def trajectory(self, episode_id: str) -> tuple[bytes, str] | None:
        """A trajectory's canonical JSON and its SHA-256, or None.

        Raises:
            DamagedTrajectoryError: it is not what was stored.
        """
        async with self._database.read() as session:
            row = await session.get(TrajectoryRow, episode_id)
        return None if row is None else (await asyncio.to_thread(_unpacked, row), row.sha256)

    # Idempotency and housekeeping

    async def reply(self, scope: str, key_sha256: str) -> IdempotencyRow | None:
        """What a repeat of a request gets, or None."""
        async with self._database.read() as session:
            return await session.get(IdempotencyRow, (scope, key_sha256))

    async def purge(self, *, practice_before: float, replies_before: float) -> None:
        """Drop practice episodes and idempotent replies from before these times, seconds since 1970."""
        async with self._database.write() as session:
            old = select(EpisodeRow.id).where(
                EpisodeRow.evaluation_id.is_(None),
                EpisodeRow.state != EpisodeState.OPEN,
                EpisodeRow.finished < practice_before,
            )
            await session.execute(delete(TrajectoryRow).where(TrajectoryRow.episode_id.in_(old)))
            await session.execute(delete(EpisodeRow).where(EpisodeRow.id.in_(old)))
            await session.execute(delete(IdempotencyRow).where(IdempotencyRow.created < replies_before))


def _add(session: AsyncSession, *rows: AgentRow | EvaluationRow | EpisodeRow | IdempotencyRow | None) -> None:
    session.add_all([row for row in rows if row is not None])


def _unpacked(row: TrajectoryRow) -> bytes:
    try:
        trajectory = zlib.decompress(row.data)
    except zlib.error as error:
        raise DamagedTrajectoryError(f"trajectory of {row.episode_id}: {error}") from error
    if hashlib.sha256(trajectory).hexdigest() != row.sha256:
        raise DamagedTrajectoryError(f"trajectory of {row.episode_id}: its SHA-256 is not what was stored")
    return trajectory
