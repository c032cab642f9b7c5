"""Queries about finished evaluations, for pages.

Running evaluations are not public, nor is what the operator hides. No query here finds them.
"""

import asyncio
import zlib
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

from sqlalchemy import ColumnElement, func, or_, select
from sqlalchemy.orm import aliased

from wrongturn_protocol import EpisodeState, EvaluationState, FaultKind, Outcome, Trial, twin_id
from wrongturn_service.storage.models import AgentRow, EpisodeRow, EvaluationRow, TrajectoryRow
from wrongturn_service.storage.queries import Queries
from wrongturn_service.storage.visible import (
    counting_suites,
    has_evaluation,
    public_evaluations,
    seen_agents,
    seen_evaluations,
)


class FinishedEpisode(NamedTuple):
    """A finished episode of a finished evaluation."""

    id: str
    evaluation: str
    trial: Trial
    outcome: Outcome


class FinishedStore(Queries):
    """Reads finished evaluations. Each method is one transaction."""

    async def agent_counts(self) -> tuple[int, int]:
        """Return the number of agents that have begun an evaluation, and of all."""
        everybody = select(func.count()).select_from(AgentRow).where(seen_agents())
        async with self._database.read() as session:
            evaluated = await session.scalar(everybody.where(has_evaluation())) or 0
            return evaluated, await session.scalar(everybody) or 0

    async def agents(self, *, everybody: bool, offset: int, limit: int) -> list[tuple[AgentRow, list[str]]]:
        """Return some agents by name, each with the suites on which it has finished an evaluation.

        ``everybody`` means those without an evaluation too.
        """
        some = select(AgentRow).where(seen_agents()).order_by(AgentRow.name_key).offset(offset).limit(limit)
        if not everybody:
            some = some.where(has_evaluation())
        async with self._database.read() as session:
            agents = (await session.scalars(some)).all()
            query = select(EvaluationRow.agent_id, EvaluationRow.suite).where(
                EvaluationRow.agent_id.in_([agent.id for agent in agents]),
                EvaluationRow.state == EvaluationState.FINISHED,
                EvaluationRow.hidden.is_(False),
            )
            driven = (await session.execute(query.distinct())).tuples().all()
        suites: dict[str, list[str]] = {}
        for agent, suite in sorted(driven):
            suites.setdefault(agent, []).append(suite)
        return [(agent, suites.get(agent.id, [])) for agent in agents]

    async def of_agent(self, agent_id: str) -> Sequence[EvaluationRow]:
        """Return an agent's finished evaluations in the order in which they were begun."""
        query = select(EvaluationRow).where(EvaluationRow.agent_id == agent_id, *public_evaluations())
        return await self._all(query.order_by(EvaluationRow.seq))

    async def running(self, agent_id: str) -> list[tuple[str, int, int]]:
        """Return an agent's open evaluations: the suite, and how many of how many episodes are driven."""
        driven = select(func.count()).where(
            EpisodeRow.evaluation_id == EvaluationRow.id, EpisodeRow.state == EpisodeState.FINISHED
        )
        query = select(EvaluationRow.suite, driven.scalar_subquery(), EvaluationRow.trials).where(
            EvaluationRow.agent_id == agent_id, EvaluationRow.state == EvaluationState.RUNNING, seen_evaluations()
        )
        return list(await self._rows(query.order_by(EvaluationRow.seq)))

    async def counting(self, agent_id: str) -> set[str]:
        """Return the ids of an agent's evaluations that count: the first on each suite, hidden ones too."""
        query = select(EvaluationRow.suite, EvaluationRow.id).where(
            EvaluationRow.agent_id == agent_id, EvaluationRow.state == EvaluationState.FINISHED, counting_suites()
        )
        # Of a suite's evaluations, the first one stays.
        return set(dict(await self._rows(query.order_by(EvaluationRow.seq.desc()))).values())

    async def evaluation(self, evaluation_id: str) -> tuple[EvaluationRow, AgentRow] | None:
        """Return a finished evaluation and its agent, or None."""
        query = (
            select(EvaluationRow, AgentRow)
            .join(AgentRow, AgentRow.id == EvaluationRow.agent_id)
            .where(EvaluationRow.id == evaluation_id, *public_evaluations())
        )
        return next(iter(await self._rows(query)), None)

    async def episodes(self, evaluation_id: str) -> list[FinishedEpisode]:
        """Return an evaluation's episodes in the order of their resets; none if it is not finished."""
        return await self._episodes(EpisodeRow.evaluation_id == evaluation_id)

    async def episode(self, episode_id: str) -> FinishedEpisode | None:
        """Return an episode, or None."""
        return next(iter(await self._episodes(EpisodeRow.id == episode_id)), None)

    async def counterpart(self, episode: FinishedEpisode) -> FinishedEpisode | None:
        """Return the episode of a trial's twin, or that of a twin's trial, in the same evaluation; None without one."""
        trial = episode.trial
        if trial.journey is not None:
            return None
        if not trial.is_twin:
            wanted = EpisodeRow.trial_id == twin_id(trial)
        else:
            # A twin has a seed of its own, but its id has the trial's.
            place, number = f"{trial.town}.{trial.approach}.", trial.id.rpartition(".")[2]
            named = (f"{place}{kind}%.{number}" for kind in FaultKind if kind is not FaultKind.NONE)
            wanted = or_(*(EpisodeRow.trial_id.like(one) for one in named))
        return next(iter(await self._episodes(EpisodeRow.evaluation_id == episode.evaluation, wanted)), None)

    async def forks(self, episode_id: str) -> list[FinishedEpisode]:
        """Return the finished forks of an episode, or the one with this id, in the order of their resets.

        Each has the evaluation of the episode that it comes from.
        """
        origin = aliased(EpisodeRow)
        mine = or_(EpisodeRow.origin_id == episode_id, EpisodeRow.id == episode_id)
        return await self._episodes(mine, of=origin, order=EpisodeRow.created)

    async def trajectories(self, evaluation_id: str, episodes: Collection[str] | None = None) -> dict[str, bytes]:
        """Return the canonical JSON of an evaluation's trajectories, by episode.

        ``episodes`` are ids of at most a few hundred, None for all.
        """
        query = (
            select(TrajectoryRow.episode_id, TrajectoryRow.data)
            .join(EpisodeRow, EpisodeRow.id == TrajectoryRow.episode_id)
            .join(EvaluationRow, EvaluationRow.id == EpisodeRow.evaluation_id)
            .where(EvaluationRow.id == evaluation_id, *public_evaluations())
        )
        if episodes is not None:
            query = query.where(TrajectoryRow.episode_id.in_(episodes))
        rows = await self._rows(query)
        return await asyncio.to_thread(lambda: {episode: zlib.decompress(data) for episode, data in rows})

    async def _episodes(
        self, *conditions: ColumnElement[bool], of: type[EpisodeRow] = EpisodeRow, order: Any = EpisodeRow.seq
    ) -> list[FinishedEpisode]:
        """Return finished episodes. ``of`` is whose evaluation has to be public: they themselves, or their origins."""
        ended = EpisodeRow.state == EpisodeState.FINISHED, EpisodeRow.outcome.is_not(None)
        chosen = select(EpisodeRow.id, EvaluationRow.id, EpisodeRow.trial, EpisodeRow.outcome)
        if of is not EpisodeRow:
            chosen = chosen.join(of, of.id == EpisodeRow.origin_id)
        query = (
            chosen.join(EvaluationRow, EvaluationRow.id == of.evaluation_id)
            .where(*public_evaluations(), *ended, *conditions)
            .order_by(order)
        )
        return [
            FinishedEpisode(row, evaluation, Trial.model_validate_json(trial), Outcome.model_validate_json(outcome))
            for row, evaluation, trial, outcome in await self._rows(query)
        ]
