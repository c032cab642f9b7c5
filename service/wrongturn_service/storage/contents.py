"""What hangs on an owner, an agent, an evaluation or a submission: conditions, numbers and bytes."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final

from sqlalchemy import ColumnElement, false, func, or_, select
from sqlalchemy.ext.asyncio import AsyncSession

from wrongturn_protocol.administration import Contents
from wrongturn_protocol.vocabulary import Collection
from wrongturn_service.storage.models import (
    AgentRow,
    EpisodeRow,
    EvaluationRow,
    IdempotencyRow,
    OwnerRow,
    ResultsRow,
    SubmissionLogRow,
    SubmissionRow,
    TrajectoryRow,
)
from wrongturn_service.storage.usage import SUBMISSION

_HEAD: Final = 512
"""Bytes of a stored reply in which the ids of what it made stand."""
_IDS: Final = re.compile(rb"(?:ow|ag|ev|ep|su)_[0-9a-f]{24}")


@dataclass(frozen=True)
class Scope:
    """Conditions of all that hangs on a target."""

    owners: ColumnElement[bool] = field(default_factory=false)
    agents: ColumnElement[bool] = field(default_factory=false)
    evaluations: ColumnElement[bool] = field(default_factory=false)
    episodes: ColumnElement[bool] = field(default_factory=false)
    submissions: ColumnElement[bool] = field(default_factory=false)

    @property
    def trajectories(self) -> ColumnElement[bool]:
        """Condition of trajectories."""
        return TrajectoryRow.episode_id.in_(select(EpisodeRow.id).where(self.episodes))

    @property
    def results(self) -> ColumnElement[bool]:
        """Condition of workers' own records."""
        return ResultsRow.evaluation_id.in_(select(EvaluationRow.id).where(self.evaluations))


async def scope_of(session: AsyncSession, collection: Collection, item_id: str) -> Scope:
    """Return the conditions of all that hangs on an item, with the item itself."""
    match collection:
        case Collection.OWNERS:
            agents = select(AgentRow.id).where(AgentRow.owner_id == item_id)
            return Scope(
                OwnerRow.id == item_id,
                AgentRow.owner_id == item_id,
                EvaluationRow.agent_id.in_(agents),
                EpisodeRow.agent_id.in_(agents),
                SubmissionRow.owner_id == item_id,
            )
        case Collection.AGENTS:
            return Scope(
                OwnerRow.id == await _owner_made_with(session, item_id),
                AgentRow.id == item_id,
                EvaluationRow.agent_id == item_id,
                EpisodeRow.agent_id == item_id,
                SubmissionRow.agent_id == item_id,
            )
        case Collection.EVALUATIONS:
            return Scope(evaluations=EvaluationRow.id == item_id, episodes=EpisodeRow.evaluation_id == item_id)
        case Collection.SUBMISSIONS:
            return Scope(submissions=SubmissionRow.id == item_id)


async def _owner_made_with(session: AsyncSession, agent_id: str) -> str | None:
    """Return the owner that was made with an agent: it has the agent's name, and nothing else."""
    agent = await session.get(AgentRow, agent_id)
    if agent is None or agent.owner.token_sha256 is not None or agent.owner.name_key != agent.name_key:
        return None
    others = select(AgentRow.id).where(AgentRow.owner_id == agent.owner_id, AgentRow.id != agent_id).limit(1)
    if await session.scalar(others) is not None:
        return None
    submissions = select(SubmissionRow.id).where(
        SubmissionRow.owner_id == agent.owner_id, SubmissionRow.agent_id.is_distinct_from(agent_id)
    )
    return None if await session.scalar(submissions.limit(1)) is not None else agent.owner_id


async def counted_episodes(session: AsyncSession, scope: Scope) -> Contents:
    """Return the numbers and bytes of episodes and their trajectories."""
    episodes = select(
        func.count(), func.sum(func.length(EpisodeRow.trial)), func.sum(func.length(EpisodeRow.last_reply))
    )
    number, trials, replies = (await session.execute(episodes.where(scope.episodes))).one()
    stored = select(func.count(), func.sum(func.length(TrajectoryRow.data)))
    trajectories, data = (await session.execute(stored.where(scope.trajectories))).one()
    return Contents(
        episodes=number, trajectories=trajectories, bytes=int(trials or 0) + int(replies or 0) + int(data or 0)
    )


async def counted(session: AsyncSession, scope: Scope) -> Contents:
    """Return the numbers and bytes of all but episodes, replies and models."""

    async def count(row: Any, where: ColumnElement[bool], size: Any) -> tuple[int, int]:
        query = select(func.count(), func.sum(size)).select_from(row).where(where)
        number, size_of_all = (await session.execute(query)).one()
        return number, int(size_of_all or 0)

    owners, _ = await count(OwnerRow, scope.owners, func.length(OwnerRow.name))
    agents, described = await count(AgentRow, scope.agents, func.length(AgentRow.description))
    evaluations, metrics = await count(EvaluationRow, scope.evaluations, func.length(EvaluationRow.metrics))
    results, records = await count(ResultsRow, scope.results, func.length(ResultsRow.body))
    submissions, _ = await count(SubmissionRow, scope.submissions, SubmissionRow.size)
    of_submissions = SubmissionLogRow.submission_id.in_(select(SubmissionRow.id).where(scope.submissions))
    _, logged = await count(SubmissionLogRow, of_submissions, func.length(SubmissionLogRow.message))
    return Contents(
        owners=owners,
        agents=agents,
        evaluations=evaluations,
        results=results,
        submissions=submissions,
        bytes=described + metrics + records + logged,
    )


async def everything(session: AsyncSession, collection: Collection, item_id: str) -> Contents:
    """Return the numbers and bytes of all that hangs on an item, without models."""
    scope = await scope_of(session, collection, item_id)
    replies = [
        size for keys in (await replies_about(session, scope, collection, item_id)).values() for size in keys.values()
    ]
    found = Contents(replies=len(replies), bytes=sum(replies))
    return total(await counted(session, scope), await counted_episodes(session, scope), found)


async def replies_about(
    session: AsyncSession, scope: Scope, collection: Collection, item_id: str
) -> dict[str, dict[str, int]]:
    """Return the bytes of the stored replies about an item, by whose they are and the hash of their key."""
    ids = {
        name
        for row, where in (
            (OwnerRow, scope.owners),
            (AgentRow, scope.agents),
            (EvaluationRow, scope.evaluations),
            (EpisodeRow, scope.episodes),
            (SubmissionRow, scope.submissions),
        )
        for name in (await session.scalars(select(row.id).where(where))).all()
    }
    owner = await owner_of_item(session, collection, item_id)
    head = func.substr(IdempotencyRow.body, 1, _HEAD)
    query = select(
        IdempotencyRow.scope,
        IdempotencyRow.key_sha256,
        IdempotencyRow.episode_id,
        func.length(IdempotencyRow.body),
        head,
    ).where(or_(IdempotencyRow.owner_id == owner, IdempotencyRow.scope.in_(_holders(scope))))
    found: dict[str, dict[str, int]] = {}
    for name, key, episode, size, begin in (await session.execute(query)).tuples():
        if name in ids or episode in ids or not ids.isdisjoint(_named(begin)):
            found.setdefault(name, {})[key] = size
    return found


async def owner_of_item(session: AsyncSession, collection: Collection, item_id: str) -> str | None:
    """Return the id of the owner whose bytes an item counts to."""
    match collection:
        case Collection.OWNERS:
            return item_id
        case Collection.AGENTS:
            query = select(AgentRow.owner_id).where(AgentRow.id == item_id)
        case Collection.EVALUATIONS:
            query = select(AgentRow.owner_id).join(EvaluationRow, EvaluationRow.agent_id == AgentRow.id)
            query = query.where(EvaluationRow.id == item_id)
        case Collection.SUBMISSIONS:
            query = select(SubmissionRow.owner_id).where(SubmissionRow.id == item_id)
    return await session.scalar(query)


def _holders(scope: Scope) -> Any:
    """Return the query of all whose own keys go with the scope."""
    agents = select(AgentRow.id).where(scope.agents)
    submissions = select(SubmissionRow.id).where(scope.submissions)
    return select(OwnerRow.id).where(scope.owners).union_all(agents, submissions)


def _named(begin: bytes) -> Iterable[str]:
    return (found.decode() for found in _IDS.findall(bytes(begin)))


def total(*parts: Contents) -> Contents:
    """Return the sum of some contents."""
    return Contents(**{name: sum(getattr(part, name) for part in parts) for name in Contents.model_fields})


async def usage(session: AsyncSession, begin: int, limit: int) -> tuple[list[tuple[str, str, Contents]], Contents]:
    """Return some owners with what they have stored, those with the most bytes first, and the sum over all owners.

    Args:
        session: The session.
        begin: Owners to leave out at the beginning.
        limit: Most owners.
    """
    stored = select(OwnerRow.id, OwnerRow.name, OwnerRow.stored_bytes)
    page = stored.order_by(OwnerRow.stored_bytes.desc(), OwnerRow.id).offset(begin).limit(limit)
    rows = (await session.execute(page)).tuples().all()
    found: dict[str, dict[str, int]] = {owner: {"owners": 1, "bytes": size} for owner, _, size in rows}
    everything: dict[str, int] = {}
    for name, query, owner_id in _numbers():
        of_page = query.add_columns(owner_id).where(owner_id.in_(found)).group_by(owner_id)
        for number, owner in (await session.execute(of_page)).tuples():
            found[owner][name] = number
        everything[name] = await session.scalar(query) or 0
    number, size = (await session.execute(select(func.count(), func.sum(OwnerRow.stored_bytes)))).one()
    total_of_all = Contents(**everything, owners=number, bytes=int(size or 0))
    return [(owner, name, Contents(**found[owner])) for owner, name, _ in rows], total_of_all


def _numbers() -> list[tuple[str, Any, Any]]:
    """Return queries that count all of a kind, each with the kind and the column of the owner."""
    evaluations = select(func.count(EvaluationRow.id)).join(AgentRow, AgentRow.id == EvaluationRow.agent_id)
    episodes = select(func.count(EpisodeRow.id)).join(AgentRow, AgentRow.id == EpisodeRow.agent_id)
    trajectories = select(func.count(TrajectoryRow.episode_id)).join(
        EpisodeRow, EpisodeRow.id == TrajectoryRow.episode_id
    )
    trajectories = trajectories.join(AgentRow, AgentRow.id == EpisodeRow.agent_id)
    results = select(func.count(ResultsRow.evaluation_id)).join(
        EvaluationRow, EvaluationRow.id == ResultsRow.evaluation_id
    )
    results = results.join(AgentRow, AgentRow.id == EvaluationRow.agent_id)
    models = select(func.count(SubmissionRow.id)).where(SubmissionRow.stored_bytes > SUBMISSION)
    return [
        ("agents", select(func.count(AgentRow.id)), AgentRow.owner_id),
        ("evaluations", evaluations, AgentRow.owner_id),
        ("episodes", episodes, AgentRow.owner_id),
        ("trajectories", trajectories, AgentRow.owner_id),
        ("results", results, AgentRow.owner_id),
        ("submissions", select(func.count(SubmissionRow.id)), SubmissionRow.owner_id),
        ("models", models, SubmissionRow.owner_id),
        ("replies", select(func.count(IdempotencyRow.key_sha256)), IdempotencyRow.owner_id),
    ]
