"""All queries of the service, one method each. Rows are detached: read them, do not change them."""

import asyncio
import hashlib
import time
import zlib
from collections.abc import Callable, Sequence
from typing import Any

from sqlalchemy import delete, func, inspect, or_, select, update
from sqlalchemy.ext.asyncio import AsyncSession

from wrongturn_protocol import AgentKind, EpisodeState, EvaluationState, Outcome, Verdict
from wrongturn_service.storage import held, purging
from wrongturn_service.storage.condition import FailureKind, StorageError
from wrongturn_service.storage.database import Database
from wrongturn_service.storage.models import (
    AgentRow,
    EpisodeRow,
    EvaluationRow,
    IdempotencyRow,
    OwnerRow,
    ResultsRow,
    TrajectoryRow,
    UnusedSecretRow,
)
from wrongturn_service.storage.usage import ROW, TRAJECTORY_ROW, Quota, Usage, over_practice, owner_of, size_of
from wrongturn_service.storage.visible import (
    counting_suites,
    has_evaluation,
    seen_agents,
    seen_evaluations,
    seen_owners,
)


class AgentNameTakenError(Exception):
    """Another agent has this name."""


class OwnerNameTakenError(Exception):
    """Another owner has this name."""


class HolderGoneError(Exception):
    """The owner or the agent that calls was deleted while its call was in progress."""


class EvaluationOverError(Exception):
    """The evaluation takes no more episodes or steps: it is finished, cancelled or deleted."""


class DamagedTrajectoryError(StorageError):
    """A stored trajectory differs from what was written."""

    kind = FailureKind.DAMAGED


class Store:
    """Reads and writes the database. Each method is one transaction.

    Methods that create something also take the reply for the idempotency key, so that both are stored or neither is.
    """

    def __init__(self, database: Database, quota: Quota | None = None) -> None:
        """Use a database.

        Args:
            database: The database.
            quota: What owners and addresses may have. None for no limits.
        """
        self._database = database
        self._usage = Usage(quota)

    @property
    def trouble(self) -> str | None:
        """Why the database cannot be used now, as a sentence; None if nothing is known against it."""
        return self._database.condition.trouble

    async def ping(self) -> None:
        """Query the database. Raises SQLAlchemy's errors if it does not answer or belongs to another service."""
        self._database.check()
        async with self._database.read() as session:
            await session.execute(select(1))

    # Owners

    async def add_owner(self, owner: OwnerRow, reply: IdempotencyRow | None) -> None:
        """Store a new owner. Raises OwnerNameTakenError, QuotaReachedError."""
        async with self._database.write() as session:
            await _check_owner_name(session, owner)
            await self._usage.check_accounts(session, owner, agents=0, owners=1)
            await self._add_owner(session, owner)
            await self._usage.remember(session, reply, owner.id)

    async def _add_owner(self, session: AsyncSession, owner: OwnerRow) -> None:
        owner.stored_bytes, owner.active = size_of(owner.contact), owner.created
        session.add(owner)
        await session.flush()
        await self._usage.check(session, owner.id, 0)

    async def reserve_owner(self, owner: OwnerRow) -> OwnerRow | None:
        """Store a new owner, unless it is there already.

        An owner of its name that an upgrade made of an agent is somebody else; the rest of its id is the agent's.
        It gets a number behind its name, and the new owner gets its agents of other kinds than ``submitted``.

        Returns:
            The owner that has a new name now, or None.
        """
        async with self._database.write() as session:
            found = await session.scalar(select(OwnerRow).where(OwnerRow.name_key == owner.name_key))
            if found is None:
                session.add(owner)
            elif await session.get(AgentRow, f"ag{found.id[2:]}") is None:
                return None
            else:
                taken = set((await session.scalars(select(OwnerRow.name_key))).all())
                names = (f"{found.name}-{number}" for number in range(2, len(taken) + 3))
                found.name = next(name for name in names if name.lower() not in taken)
                found.name_key = found.name.lower()
                await session.flush()  # the name has to be free before another has it
                session.add(owner)
                await session.flush()
                shipped = update(AgentRow).where(AgentRow.owner_id == found.id, AgentRow.kind != AgentKind.SUBMITTED)
                await session.execute(shipped.values(owner_id=owner.id))
        return found

    async def owners(self, *, after: str | None = None, limit: int | None = None) -> Sequence[OwnerRow]:
        """Return owners by name, without hidden ones.

        Args:
            after: Name in lower case after which to begin.
            limit: Most owners. None for all.
        """
        query = select(OwnerRow).where(seen_owners()).order_by(OwnerRow.name_key).limit(limit)
        if after is not None:
            query = query.where(OwnerRow.name_key > after)
        async with self._database.read() as session:
            return (await session.scalars(query)).all()

    async def owner(self, owner_id: str) -> OwnerRow | None:
        """Return an owner, or None."""
        async with self._database.read() as session:
            return await session.get(OwnerRow, owner_id)

    async def owner_by_name(self, name_key: str) -> OwnerRow | None:
        """Return the owner with a name in lower case, or None."""
        async with self._database.read() as session:
            return await session.scalar(select(OwnerRow).where(OwnerRow.name_key == name_key))

    async def owner_by_token(self, token_sha256: str) -> OwnerRow | None:
        """Return the owner with this token, or None."""
        async with self._database.read() as session:
            return await session.scalar(select(OwnerRow).where(OwnerRow.token_sha256 == token_sha256))

    async def set_owner_token(
        self, owner_id: str, token_sha256: str | None, reply: IdempotencyRow | None = None
    ) -> None:
        """Replace an owner's token. None revokes it."""
        async with self._database.write() as session:
            await session.execute(update(OwnerRow).where(OwnerRow.id == owner_id).values(token_sha256=token_sha256))
            await self._usage.remember(session, reply, owner_id)

    # Agents

    async def add_agent(self, agent: AgentRow, reply: IdempotencyRow | None) -> None:
        """Store a new agent, and its owner if that is new.

        Raises:
            AgentNameTakenError, OwnerNameTakenError.
            QuotaReachedError: The owner or its address has too many agents or bytes.
        """
        owner = agent.owner
        async with self._database.write() as session:
            if await agent_name_taken(session, agent.name_key):
                raise AgentNameTakenError(agent.name)
            new = inspect(owner).transient
            if new:
                await _check_owner_name(session, owner)
            else:
                await check_there(session, OwnerRow, owner.id)
            await self._usage.check_accounts(session, owner, agents=1, owners=int(new))
            if new:
                await self._add_owner(session, owner)
            agent.stored_bytes = size_of(agent.description, agent.homepage)
            await self._usage.take(session, owner.id, agent.stored_bytes)
            session.add(agent)
            await self._usage.remember(session, reply, owner.id)

    async def agents(
        self, *, evaluated: bool = False, after: str | None = None, limit: int | None = None
    ) -> Sequence[AgentRow]:
        """Return agents by name, without hidden ones.

        Args:
            evaluated: Leaves out those without an evaluation, which at most have practised.
            after: Name in lower case after which to begin.
            limit: Most agents. None for all.
        """
        query = select(AgentRow).where(seen_agents()).order_by(AgentRow.name_key).limit(limit)
        if evaluated:
            query = query.where(has_evaluation())
        if after is not None:
            query = query.where(AgentRow.name_key > after)
        async with self._database.read() as session:
            return (await session.scalars(query)).all()

    async def agent(self, agent_id: str) -> AgentRow | None:
        """Return an agent, or None."""
        async with self._database.read() as session:
            return await session.get(AgentRow, agent_id)

    async def agent_called(self, wanted: str) -> AgentRow | None:
        """Return the agent that has this id, or else this name in upper or lower case; None without either.

        Hidden ones are left out.
        """
        if "\0" in wanted:  # which PostgreSQL refuses
            return None
        async with self._database.read() as session:
            called = or_(AgentRow.id == wanted, AgentRow.name_key == wanted.lower())
            query = select(AgentRow).where(called, seen_agents())
            found = (await session.scalars(query)).all()
        # A name may look like another agent's id.
        return max(found, key=lambda agent: agent.id == wanted, default=None)

    async def agent_by_token(self, token_sha256: str) -> AgentRow | None:
        """Return the agent with this token, or None."""
        async with self._database.read() as session:
            return await session.scalar(select(AgentRow).where(AgentRow.token_sha256 == token_sha256))

    async def set_token(self, agent_id: str, token_sha256: str | None, reply: IdempotencyRow | None = None) -> None:
        """Replace an agent's token. None revokes it."""
        async with self._database.write() as session:
            await session.execute(update(AgentRow).where(AgentRow.id == agent_id).values(token_sha256=token_sha256))
            await self._usage.remember(session, reply, await owner_of(session, agent_id))

    # Evaluations

    async def begin_evaluation(
        self, evaluation: EvaluationRow, remember: Callable[[EvaluationRow], IdempotencyRow] | None
    ) -> EvaluationRow:
        """Store a new evaluation, unless one of the agent on the suite is running.

        It takes the secret of the agent's last evaluation on the suite if that one was deleted before its first step.

        Args:
            evaluation: The new evaluation.
            remember: Makes the reply for the idempotency key.

        Returns:
            The running evaluation: the new one, or the one that was there before.

        Raises:
            QuotaReachedError: What it can come to does not fit.
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
            await self._usage.take(session, owner, evaluation.stored_bytes)
            session.add(evaluation)
            await self._usage.remember(session, None if remember is None else remember(evaluation), owner)
        return evaluation

    async def evaluation(self, evaluation_id: str) -> EvaluationRow | None:
        """Return an evaluation, or None."""
        async with self._database.read() as session:
            return await session.get(EvaluationRow, evaluation_id)

    async def is_public(self, evaluation_id: str) -> bool:
        """Return whether everybody may see an evaluation: it is finished, and the operator does not hide it."""
        async with self._database.read() as session:
            query = select(EvaluationRow.id).where(
                EvaluationRow.id == evaluation_id, EvaluationRow.state == EvaluationState.FINISHED, seen_evaluations()
            )
            return await session.scalar(query) is not None

    async def running_evaluations(self) -> Sequence[EvaluationRow]:
        """Return the evaluations that are neither finished nor cancelled."""
        async with self._database.read() as session:
            query = select(EvaluationRow).where(EvaluationRow.state == EvaluationState.RUNNING)
            return (await session.scalars(query)).all()

    async def running_since(self) -> list[tuple[str, float, float]]:
        """Return each running evaluation, when it was begun, and when it last had a reset or an episode's end."""
        async with self._database.read() as session:
            last = func.max(func.coalesce(EpisodeRow.finished, EpisodeRow.created))
            query = (
                select(EvaluationRow.id, EvaluationRow.created, last)
                .outerjoin(EpisodeRow, EpisodeRow.evaluation_id == EvaluationRow.id)
                .where(EvaluationRow.state == EvaluationState.RUNNING)
                .group_by(EvaluationRow.id, EvaluationRow.created)
            )
            rows = (await session.execute(query)).all()
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

    async def finish_evaluation(self, evaluation_id: str, metrics: str) -> bool:
        """Store an evaluation's metrics. Return False if it was finished before."""
        async with self._database.write() as session:
            query = update(EvaluationRow).where(
                EvaluationRow.id == evaluation_id,
                EvaluationRow.state == EvaluationState.RUNNING,
            )
            values = {"state": EvaluationState.FINISHED, "finished": time.time(), "metrics": metrics}
            if not getattr(await session.execute(query.values(**values)), "rowcount", 0):
                return False
            await self._usage.settle_evaluation(session, evaluation_id, size_of(metrics))
            return True

    async def retire_evaluation(self, evaluation_id: str) -> None:
        """Cancel a running evaluation whose suite was retired. It has no end, because its agent did not cancel it."""
        async with self._database.write() as session:
            query = update(EvaluationRow).where(
                EvaluationRow.id == evaluation_id, EvaluationRow.state == EvaluationState.RUNNING
            )
            if getattr(await session.execute(query.values(state=EvaluationState.CANCELLED)), "rowcount", 0):
                await self._usage.settle_evaluation(session, evaluation_id, ROW)

    async def delete_undriven(self, evaluation_id: str) -> bool:
        """Delete a running evaluation without any step, and keep its secret for the agent's next one on the suite.

        Returns:
            Whether it was deleted.
        """
        async with self._database.write() as session:
            row = await session.get(EvaluationRow, evaluation_id)
            if row is None or row.state != EvaluationState.RUNNING or row.driven is not None:
                return False
            secret = UnusedSecretRow(agent_id=row.agent_id, suite=row.suite, secret=row.secret)
            await self._usage.delete_episodes(session, EpisodeRow.evaluation_id == evaluation_id)
            results = await session.get(ResultsRow, evaluation_id)
            size = row.stored_bytes + (0 if results is None else results.stored_bytes)
            await session.execute(delete(ResultsRow).where(ResultsRow.evaluation_id == evaluation_id))
            await self._usage.add(session, await owner_of(session, row.agent_id), -size)
            await session.delete(row)
            await session.merge(secret)
        return True

    async def abort_rest(self, evaluation_id: str, aborted: Sequence[EpisodeRow]) -> None:
        """Give an ``aborted`` episode to every trial of a running evaluation that has no verdict.

        Args:
            evaluation_id: Id of the evaluation.
            aborted: A finished episode of each trial and twin.
        """
        async with self._database.write() as session:
            row = await session.get(EvaluationRow, evaluation_id)
            if row is None or row.state != EvaluationState.RUNNING:
                return
            ghosts = update(EpisodeRow).where(
                EpisodeRow.evaluation_id == evaluation_id, EpisodeRow.state == EpisodeState.OPEN
            )
            await session.execute(ghosts.values(state=EpisodeState.LOST, finished=time.time()))
            scored = select(EpisodeRow.trial_id).where(
                EpisodeRow.evaluation_id == evaluation_id, EpisodeRow.state == EpisodeState.FINISHED
            )
            done = set((await session.scalars(scored)).all())
            missing = [episode for episode in aborted if episode.trial_id not in done]
            for seq, episode in enumerate(missing, await _next_episode(session, evaluation_id)):
                episode.seq = seq
                episode.stored_bytes = size_of(episode.trial, episode.outcome)
            session.add_all(missing)

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
        """Store a worker's own record. A newer one replaces it. Raises QuotaReachedError."""
        async with self._database.write() as session:
            evaluation = await session.get(EvaluationRow, evaluation_id)
            if evaluation is None:
                return
            old = await session.get(ResultsRow, evaluation_id)
            size, now = size_of(body), time.time()
            owner = await owner_of(session, evaluation.agent_id)
            await self._usage.take(session, owner, size - (0 if old is None else old.stored_bytes))
            await session.merge(ResultsRow(evaluation_id=evaluation_id, body=body, created=now, stored_bytes=size))

    async def cancelled_counts(self, suite: str) -> dict[str, int]:
        """Return how many evaluations of a suite each agent cancelled after it had begun to drive."""
        query = (
            select(EvaluationRow.agent_id, func.count())
            .where(
                EvaluationRow.suite == suite,
                EvaluationRow.state == EvaluationState.CANCELLED,
                EvaluationRow.finished.is_not(None),  # the service itself cancels those of retired suites
                EvaluationRow.driven.is_not(None),
            )
            .group_by(EvaluationRow.agent_id)
        )
        async with self._database.read() as session:
            return dict((await session.execute(query)).tuples().all())

    async def first_finished(self, suite: str) -> Sequence[tuple[EvaluationRow, AgentRow]]:
        """Return the first evaluation that each agent began on a suite and that is finished: the one that counts.

        If the operator hides it, the agent has none.
        """
        async with self._database.read() as session:
            query = (
                select(EvaluationRow, AgentRow, seen_evaluations())
                .join(AgentRow, AgentRow.id == EvaluationRow.agent_id)
                .where(EvaluationRow.suite == suite, EvaluationRow.state == EvaluationState.FINISHED, counting_suites())
                .order_by(EvaluationRow.seq)
            )
            rows = (await session.execute(query)).tuples().all()
        first: dict[str, tuple[EvaluationRow, AgentRow, bool]] = {}
        for evaluation, agent, seen in rows:
            first.setdefault(agent.id, (evaluation, agent, seen))
        return [(evaluation, agent) for evaluation, agent, seen in first.values() if seen]

    async def finished_summary(self) -> dict[str, tuple[int, float]]:
        """Return for each suite how many agents have finished it, and when the last one did."""
        async with self._database.read() as session:
            query = (
                select(
                    EvaluationRow.suite,
                    func.count(EvaluationRow.agent_id.distinct()),
                    func.max(EvaluationRow.finished),
                )
                .where(EvaluationRow.state == EvaluationState.FINISHED, seen_evaluations(), counting_suites())
                .group_by(EvaluationRow.suite)
            )
            rows = (await session.execute(query)).all()
        return {suite: (count, newest or 0.0) for suite, count, newest in rows}

    async def check_room(self, owner_id: str, more: int) -> None:
        """Make room for so many bytes of an owner, if need be by deleting its oldest practice.

        Raises:
            QuotaReachedError: There is none.
        """
        async with self._database.read() as session:
            if await self._usage.fits(session, owner_id, more):
                return
        async with self._database.write() as session:
            await self._usage.make_room(session, owner_id, more)

    # Episodes

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
                scored = select(EpisodeRow.id).where(
                    EpisodeRow.evaluation_id == episode.evaluation_id,
                    EpisodeRow.trial_id == episode.trial_id,
                    EpisodeRow.state == EpisodeState.FINISHED,
                )
                if await session.scalar(scored) is not None:
                    raise EvaluationOverError(episode.evaluation_id)
                # The connection may have broken during an earlier commit that did succeed.
                ghost = update(EpisodeRow).where(
                    EpisodeRow.evaluation_id == episode.evaluation_id,
                    EpisodeRow.trial_id == episode.trial_id,
                    EpisodeRow.state == EpisodeState.OPEN,
                )
                await session.execute(ghost.values(state=EpisodeState.LOST, finished=time.time()))
                episode.seq = await _next_episode(session, episode.evaluation_id)
            await check_there(session, AgentRow, episode.agent_id)
            owner = await owner_of(session, episode.agent_id)
            if reply is not None:
                reply.episode_id = episode.id
            if episode.evaluation_id is None:
                episode.stored_bytes = episode.stored_bytes or ROW
                await self._usage.take(session, owner, episode.stored_bytes)
                await self._usage.remember(session, reply, owner)
            else:
                await self._usage.remember(session, reply, owner, evaluation_id=episode.evaluation_id)
            session.add(episode)

    async def episode(self, episode_id: str) -> EpisodeRow | None:
        """Return an episode, or None."""
        async with self._database.read() as session:
            return await session.get(EpisodeRow, episode_id)

    async def episodes(
        self,
        evaluation_id: str,
        state: EpisodeState | None = None,
        *,
        after: int | None = None,
        limit: int | None = None,
    ) -> Sequence[EpisodeRow]:
        """Return an evaluation's episodes in the order of their resets.

        Args:
            evaluation_id: Id of the evaluation.
            state: State of the episodes. None for all.
            after: Their ``seq`` after which to begin.
            limit: Most episodes. None for all.
        """
        query = select(EpisodeRow).where(EpisodeRow.evaluation_id == evaluation_id).order_by(EpisodeRow.seq)
        if state is not None:
            query = query.where(EpisodeRow.state == state)
        if after is not None:
            query = query.where(EpisodeRow.seq > after)
        async with self._database.read() as session:
            return (await session.scalars(query.limit(limit))).all()

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
            await self._usage.settle_episode(session, episode_id, TRAJECTORY_ROW + len(compressed) if trajectory else 0)
        return True

    async def lose_episode(self, episode_id: str, verdict: Verdict | None = None) -> None:
        """Mark an open episode as lost, so that its trial runs again."""
        async with self._database.write() as session:
            query = update(EpisodeRow).where(EpisodeRow.id == episode_id, EpisodeRow.state == EpisodeState.OPEN)
            values = {"state": EpisodeState.LOST, "finished": time.time(), "verdict": verdict}
            if getattr(await session.execute(query.values(**values)), "rowcount", 0):
                await self._usage.settle_episode(session, episode_id)

    async def lose_open_episodes(self) -> int:
        """Mark the episodes that were open when the service last stopped as lost, and return their number."""
        async with self._database.write() as session:
            is_open = EpisodeRow.state == EpisodeState.OPEN
            lost = (await session.scalars(select(EpisodeRow.id).where(is_open))).all()
            values = {"state": EpisodeState.LOST, "finished": time.time()}
            await session.execute(update(EpisodeRow).where(is_open).values(**values))
            for episode in lost:
                await self._usage.settle_episode(session, episode)
            return len(lost)

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

    async def purge(
        self, *, practice_before: float, replies_before: float, abandoned_before: float, unused_before: float
    ) -> None:
        """Delete what is old. All times are seconds since 1970.

        Args:
            practice_before: Practice that was over before.
            replies_before: Replies to idempotency keys that were stored before.
            abandoned_before: Lost episodes, and all episodes and records of cancelled evaluations, from before.
            unused_before: Owners who registered themselves, have no evaluation and no submission, and have stored
                nothing since; with their agents.
        """
        async with self._database.write() as session:
            await self._usage.delete_episodes(session, *over_practice(), EpisodeRow.finished < practice_before)
            await self._usage.delete_replies(session, IdempotencyRow.created < replies_before)
            await purging.delete_abandoned(session, self._usage, abandoned_before)
            await purging.delete_unused(session, self._usage, unused_before)


async def prepare_evaluation(session: AsyncSession, evaluation: EvaluationRow) -> None:
    """Number an evaluation that is about to be stored.

    It takes the secret of the agent's last one on the suite if that was deleted before its first step.
    """
    evaluation.seq = (await session.scalar(select(func.max(EvaluationRow.seq))) or 0) + 1
    unused = await session.get(UnusedSecretRow, (evaluation.agent_id, evaluation.suite))
    if unused is not None:
        evaluation.secret = unused.secret
        await session.delete(unused)


async def _next_episode(session: AsyncSession, evaluation_id: str) -> int:
    """Return the number of an evaluation's next episode."""
    last = select(func.max(EpisodeRow.seq)).where(EpisodeRow.evaluation_id == evaluation_id)
    return (await session.scalar(last) or 0) + 1


async def _check_owner_name(session: AsyncSession, owner: OwnerRow) -> None:
    taken = select(OwnerRow.id).where(OwnerRow.name_key == owner.name_key)
    if await session.scalar(taken) is not None or await held.is_held(session, held.OWNER, owner.name_key):
        raise OwnerNameTakenError(owner.name)


async def agent_name_taken(session: AsyncSession, name_key: str) -> bool:
    """Return whether an agent has a name in lower case, or the operator has deleted one that had it."""
    taken = select(AgentRow.id).where(AgentRow.name_key == name_key)
    return await session.scalar(taken) is not None or await held.is_held(session, held.AGENT, name_key)


async def check_there(session: AsyncSession, row: type[OwnerRow | AgentRow], holder_id: str) -> None:
    """Check that the caller was not deleted since its token was looked up. Raises HolderGoneError."""
    if await session.scalar(select(row.id).where(row.id == holder_id)) is None:
        raise HolderGoneError(holder_id)


def _unpacked(row: TrajectoryRow) -> bytes:
    try:
        trajectory = zlib.decompress(row.data)
    except zlib.error as error:
        raise DamagedTrajectoryError(f"trajectory of {row.episode_id}: {error}") from error
    if hashlib.sha256(trajectory).hexdigest() != row.sha256:
        raise DamagedTrajectoryError(f"trajectory of {row.episode_id}: its SHA-256 is not what was stored")
    return trajectory
