"""All queries of the service, one method each. Rows are detached: read them, do not change them."""

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
    """Another agent has this name."""


class DamagedTrajectoryError(SQLAlchemyError):
    """A stored trajectory differs from what was written."""


class Store:
    """Reads and writes the database. Each method is one transaction.

    Methods that create something also take the reply for the idempotency key, so that both are stored or neither is.
    """

    def __init__(self, database: Database) -> None:
        self._database = database

    async def ping(self) -> None:
        """Query the database. Raises SQLAlchemy's errors if it does not answer or belongs to another service."""
        self._database.check()
        async with self._database.read() as session:
            await session.execute(select(1))

    # Agents

    async def add_agent(self, agent: AgentRow, reply: IdempotencyRow | None) -> None:
        """Store a new agent. Raises NameTakenError."""
        try:
            async with self._database.write() as session:
                _add(session, agent, reply)
        except IntegrityError as error:
            raise NameTakenError(agent.name) from error

    async def agents(self) -> Sequence[AgentRow]:
        """Return all agents by name."""
        async with self._database.read() as session:
            return (await session.scalars(select(AgentRow).order_by(AgentRow.name_key))).all()

    async def agent(self, agent_id: str) -> AgentRow | None:
        """Return an agent, or None."""
        async with self._database.read() as session:
            return await session.get(AgentRow, agent_id)

    async def agent_by_token(self, token_sha256: str) -> AgentRow | None:
        """Return the agent with this token, or None."""
        async with self._database.read() as session:
            return await session.scalar(select(AgentRow).where(AgentRow.token_sha256 == token_sha256))

    async def set_token(self, agent_id: str, token_sha256: str | None, reply: IdempotencyRow | None = None) -> None:
        """Replace an agent's token. None revokes it."""
        async with self._database.write() as session:
            await session.execute(update(AgentRow).where(AgentRow.id == agent_id).values(token_sha256=token_sha256))
            _add(session, reply)

    # Evaluations

    async def add_evaluation(self, evaluation: EvaluationRow, reply: IdempotencyRow | None) -> None:
        """Store a new evaluation."""
        async with self._database.write() as session:
            _add(session, evaluation, reply)

    async def evaluation(self, evaluation_id: str) -> EvaluationRow | None:
        """Return an evaluation, or None."""
        async with self._database.read() as session:
            return await session.get(EvaluationRow, evaluation_id)

    async def running_evaluations(self) -> Sequence[EvaluationRow]:
        """Return the evaluations that are neither finished nor cancelled."""
        async with self._database.read() as session:
            query = select(EvaluationRow).where(EvaluationRow.state == EvaluationState.RUNNING)
            return (await session.scalars(query)).all()

    async def running_count(self, agent_id: str) -> int:
        """Return how many of an agent's evaluations are neither finished nor cancelled."""
        async with self._database.read() as session:
            query = select(func.count()).where(
                EvaluationRow.agent_id == agent_id,
                EvaluationRow.state == EvaluationState.RUNNING,
            )
            return await session.scalar(query) or 0

    async def finish_evaluation(self, evaluation_id: str, metrics: str) -> None:
        """Store an evaluation's metrics. A cancelled evaluation stays cancelled."""
        async with self._database.write() as session:
            query = update(EvaluationRow).where(
                EvaluationRow.id == evaluation_id,
                EvaluationRow.state == EvaluationState.RUNNING,
            )
            await session.execute(query.values(state=EvaluationState.FINISHED, finished=time.time(), metrics=metrics))

    async def cancel_evaluation(self, evaluation_id: str) -> None:
        """Cancel an evaluation and mark its open episodes as lost."""
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
        """Return how many of an evaluation's episodes have a verdict."""
        async with self._database.read() as session:
            query = select(func.count()).where(
                EpisodeRow.evaluation_id == evaluation_id,
                EpisodeRow.state == EpisodeState.FINISHED,
            )
            return await session.scalar(query) or 0

    async def outcomes(self, evaluation_id: str) -> dict[str, Outcome]:
        """Return the outcomes of an evaluation's finished episodes, by trial id."""
        async with self._database.read() as session:
            query = select(EpisodeRow.trial_id, EpisodeRow.outcome).where(
                EpisodeRow.evaluation_id == evaluation_id,
                EpisodeRow.state == EpisodeState.FINISHED,
            )
            rows = (await session.execute(query)).all()
        return {trial: Outcome.model_validate_json(outcome) for trial, outcome in rows if outcome is not None}

    async def put_results(self, evaluation_id: str, body: str) -> None:
        """Store a worker's own record. A newer one replaces it."""
        async with self._database.write() as session:
            await session.merge(ResultsRow(evaluation_id=evaluation_id, body=body, created=time.time()))

    async def cancelled_counts(self, suite: str) -> dict[str, int]:
        """Return how many evaluations of a suite each agent cancelled after it had begun to drive."""
        driven = select(EpisodeRow.evaluation_id).where(EpisodeRow.evaluation_id == EvaluationRow.id).exists()
        query = (
            select(EvaluationRow.agent_id, func.count())
            .where(EvaluationRow.suite == suite, EvaluationRow.state == EvaluationState.CANCELLED, driven)
            .group_by(EvaluationRow.agent_id)
        )
        async with self._database.read() as session:
            return dict((await session.execute(query)).tuples().all())

    async def first_finished(self, suite: str) -> Sequence[tuple[EvaluationRow, AgentRow]]:
        """Return each agent's first finished evaluation of a suite, which is the one that counts."""
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
        """Return for each suite how many agents have finished it, and when the last one did."""
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
        """Store an open episode. An older open episode of the same trial and evaluation is marked as lost.

        Raises:
            IntegrityError: The trial already has a verdict in this evaluation.
        """
        async with self._database.write() as session:
            if episode.evaluation_id is not None:
                # The connection may have broken during an earlier commit that did succeed.
                ghost = update(EpisodeRow).where(
                    EpisodeRow.evaluation_id == episode.evaluation_id,
                    EpisodeRow.trial_id == episode.trial_id,
                    EpisodeRow.state == EpisodeState.OPEN,
                )
                await session.execute(ghost.values(state=EpisodeState.LOST, finished=time.time()))
            _add(session, episode, reply)

    async def episode(self, episode_id: str) -> EpisodeRow | None:
        """Return an episode, or None."""
        async with self._database.read() as session:
            return await session.get(EpisodeRow, episode_id)

    async def episodes(self, evaluation_id: str, state: EpisodeState | None = None) -> Sequence[EpisodeRow]:
        """Return an evaluation's episodes in the order of their resets."""
        async with self._database.read() as session:
            query = select(EpisodeRow).where(EpisodeRow.evaluation_id == evaluation_id)
            if state is not None:
                query = query.where(EpisodeRow.state == state)
            return (await session.scalars(query.order_by(EpisodeRow.created, EpisodeRow.id))).all()

    async def trials_by_state(self, evaluation_id: str) -> dict[EpisodeState, set[str]]:
        """Return an evaluation's trial ids by the state of their episodes."""
        async with self._database.read() as session:
            query = select(EpisodeRow.state, EpisodeRow.trial_id).where(EpisodeRow.evaluation_id == evaluation_id)
            rows = (await session.execute(query)).all()
        found: dict[EpisodeState, set[str]] = {state: set() for state in EpisodeState}
        for state, trial in rows:
            found[EpisodeState(state)].add(trial)
        return found

    async def finish_episode(self, episode_id: str, values: dict[str, Any], trajectory: bytes, sha256: str) -> bool:
        """Store an episode's end. Safe to call again with the same end.

        Args:
            episode_id: Id of the episode.
            values: Columns of the episode's row.
            trajectory: Canonical JSON, empty if there is none.
            sha256: SHA-256 of the trajectory.

        Returns:
            False if the episode was given up or has another end.
        """
        # A journey with traffic has megabytes; in a thread its compression does not hold up other agents.
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
        """Mark an open episode as lost, so that its trial runs again."""
        async with self._database.write() as session:
            query = update(EpisodeRow).where(EpisodeRow.id == episode_id, EpisodeRow.state == EpisodeState.OPEN)
            await session.execute(query.values(state=EpisodeState.LOST, finished=time.time(), verdict=verdict))

    async def lose_open_episodes(self) -> int:
        """Mark the episodes that were open when the service last stopped as lost, and return their number."""
        async with self._database.write() as session:
            query = update(EpisodeRow).where(EpisodeRow.state == EpisodeState.OPEN)
            result = await session.execute(query.values(state=EpisodeState.LOST, finished=time.time()))
            return int(getattr(result, "rowcount", 0))

    async def trajectory(self, episode_id: str) -> tuple[bytes, str] | None:
        """Return a trajectory's canonical JSON and its SHA-256, or None.

        Raises:
            DamagedTrajectoryError: The stored bytes have changed.
        """
        async with self._database.read() as session:
            row = await session.get(TrajectoryRow, episode_id)
        return None if row is None else (await asyncio.to_thread(_unpacked, row), row.sha256)

    # Idempotency and housekeeping

    async def reply(self, scope: str, key_sha256: str) -> IdempotencyRow | None:
        """Return the stored reply to a request with this key, or None."""
        async with self._database.read() as session:
            return await session.get(IdempotencyRow, (scope, key_sha256))

    async def purge(self, *, practice_before: float, replies_before: float) -> None:
        """Delete practice episodes and stored replies from before these times, seconds since 1970."""
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
