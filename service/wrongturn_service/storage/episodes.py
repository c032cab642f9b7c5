"""Queries about episodes and trajectories."""

import asyncio
import hashlib
import time
import zlib
from collections.abc import Sequence
from typing import Any

from sqlalchemy import Update, func, select, update

from wrongturn_protocol import EpisodeState, EvaluationState, Verdict
from wrongturn_service.storage.accounts import check_there
from wrongturn_service.storage.condition import FailureKind, StorageError
from wrongturn_service.storage.evaluations import EvaluationOverError, next_episode
from wrongturn_service.storage.models import AgentRow, EpisodeRow, EvaluationRow, IdempotencyRow, TrajectoryRow
from wrongturn_service.storage.queries import Queries
from wrongturn_service.storage.usage import ROW, TRAJECTORY_ROW, owner_of, size_of


class DamagedTrajectoryError(StorageError):
    """A stored trajectory differs from what was written."""

    kind = FailureKind.DAMAGED


class EpisodeStore(Queries):
    """Reads and writes episodes and their trajectories."""

    async def add_episode(self, episode: EpisodeRow, reply: IdempotencyRow | None) -> None:
        """Store an open episode. An older open episode of the same trial and evaluation is marked as lost.

        Raises:
            EvaluationOverError: The evaluation takes no more episodes, or has a verdict of this trial.
            QuotaReachedError: It is practice, and what it can come to does not fit.
        """
        async with self._database.write() as session:
            if episode.evaluation_id is not None:
                evaluation = await session.get(EvaluationRow, episode.evaluation_id)
                if evaluation is None or evaluation.state != EvaluationState.RUNNING:
                    raise EvaluationOverError(episode.evaluation_id)
                of_trial = EpisodeRow.evaluation_id == evaluation.id, EpisodeRow.trial_id == episode.trial_id
                scored = select(EpisodeRow.id).where(*of_trial, EpisodeRow.state == EpisodeState.FINISHED)
                if await session.scalar(scored) is not None:
                    raise EvaluationOverError(episode.evaluation_id)
                # The connection may have broken during an earlier commit that did succeed.
                await session.execute(_lost().where(*of_trial))
                episode.seq = await next_episode(session, episode.evaluation_id)
            await check_there(session, AgentRow, episode.agent_id)
            if episode.origin_id is not None and await session.get(EpisodeRow, episode.origin_id) is None:
                episode.origin_id = None  # deleted meanwhile
            owner = await owner_of(session, episode.agent_id)
            if episode.evaluation_id is None:
                episode.stored_bytes = episode.stored_bytes or ROW
                await self._usage.take(session, owner, episode.stored_bytes)
            session.add(episode)
            about = {"agent_id": episode.agent_id, "episode_id": episode.id, "evaluation_id": episode.evaluation_id}
            await self._usage.remember(session, reply, owner, about, reserved=episode.evaluation_id is not None)

    async def episode(self, episode_id: str) -> EpisodeRow | None:
        """Return an episode, or None."""
        return await self._get(EpisodeRow, episode_id)

    async def episodes(
        self,
        evaluation_id: str,
        state: EpisodeState | None = None,
        *,
        after: int | None = None,
        limit: int | None = None,
    ) -> Sequence[EpisodeRow]:
        """Return an evaluation's episodes in the order of their resets.

        ``after`` is the ``seq`` after which to begin.
        """
        query = select(EpisodeRow).where(EpisodeRow.evaluation_id == evaluation_id).order_by(EpisodeRow.seq)
        if state is not None:
            query = query.where(EpisodeRow.state == state)
        if after is not None:
            query = query.where(EpisodeRow.seq > after)
        return await self._all(query.limit(limit))

    async def trials_by_state(self, evaluation_id: str) -> dict[EpisodeState, set[str]]:
        """Return an evaluation's trial ids by the state of their episodes."""
        query = select(EpisodeRow.state, EpisodeRow.trial_id).where(EpisodeRow.evaluation_id == evaluation_id)
        found: dict[EpisodeState, set[str]] = {state: set() for state in EpisodeState}
        for state, trial in await self._rows(query):
            found[EpisodeState(state)].add(trial)
        return found

    async def finish_episode(self, episode_id: str, values: dict[str, Any], trajectory: bytes, sha256: str) -> bool:
        """Store an episode's end. Safe to call again with the same end.

        The trajectory is canonical JSON, empty if there is none.

        Returns:
            False if the episode was given up or has another end.
        """
        # A journey with traffic has megabytes; in a thread its compression does not hold up other agents.
        compressed = await asyncio.to_thread(zlib.compress, trajectory, 6)
        async with self._database.write() as session:
            row = await session.get(EpisodeRow, episode_id)
            if row is None or row.state != EpisodeState.OPEN:
                return (
                    row is not None
                    and row.state == EpisodeState.FINISHED
                    and all(getattr(row, name) == value for name, value in values.items())
                )
            for name, value in {"state": EpisodeState.FINISHED, "finished": time.time(), **values}.items():
                setattr(row, name, value)
            row.stored_bytes = size_of(row.trial, row.outcome, row.last_reply)
            if trajectory:
                row.stored_bytes += TRAJECTORY_ROW + len(compressed)
                session.add(TrajectoryRow(episode_id=episode_id, sha256=sha256, size=len(trajectory), data=compressed))
        return True

    async def lose_episode(self, episode_id: str, verdict: Verdict | None = None) -> None:
        """Mark an open episode as lost, so that its trial runs again."""
        await self._write(_lost(verdict=verdict).where(EpisodeRow.id == episode_id))

    async def lose_open_episodes(self) -> int:
        """Mark the episodes that were open when the service last stopped as lost, and return their number."""
        return await self._write(_lost())

    async def trajectory(self, episode_id: str) -> tuple[bytes, str] | None:
        """Return a trajectory's canonical JSON and its SHA-256, or None. Raises DamagedTrajectoryError."""
        row = await self._get(TrajectoryRow, episode_id)
        return None if row is None else (await asyncio.to_thread(_unpacked, row), row.sha256)


def _lost(**columns: Any) -> Update:
    """Return what marks open episodes as lost."""
    over = {"state": EpisodeState.LOST, "finished": time.time(), "stored_bytes": ROW + func.length(EpisodeRow.trial)}
    return update(EpisodeRow).where(EpisodeRow.state == EpisodeState.OPEN).values(**over, **columns)


def _unpacked(row: TrajectoryRow) -> bytes:
    try:
        trajectory = zlib.decompress(row.data)
    except zlib.error as error:
        raise DamagedTrajectoryError(f"trajectory of {row.episode_id}: {error}") from error
    if hashlib.sha256(trajectory).hexdigest() != row.sha256:
        raise DamagedTrajectoryError(f"trajectory of {row.episode_id}: its SHA-256 is not what was stored")
    return trajectory
