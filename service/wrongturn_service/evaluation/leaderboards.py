"""Leaderboards. Each is computed again after an evaluation of its suite has finished."""

import asyncio
from datetime import UTC, datetime
from functools import lru_cache

from wrongturn_judge.comparison import Side, compare
from wrongturn_judge.ranking import RankingInput, rank
from wrongturn_networks import load_suite, suite_ids
from wrongturn_protocol import (
    Comparison,
    Entry,
    FieldError,
    Leaderboard,
    LeaderboardEntry,
    LeaderboardList,
    LeaderboardSummary,
    Metrics,
    ProblemType,
)
from wrongturn_service import catalogue
from wrongturn_service.accounts import detail
from wrongturn_service.errors import InvalidRequestError, NotFoundError
from wrongturn_service.evaluation.algorithms import algorithm_rows
from wrongturn_service.storage.store import Store


class Leaderboards:
    """Leaderboards by suite."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._boards: dict[str, tuple[Leaderboard, bytes, dict[str, Metrics]]] = {}
        """By suite: the leaderboard, its JSON, and the metrics of each evaluation on it."""
        self._algorithms: dict[str, list[RankingInput]] = {}
        self._lock = asyncio.Lock()
        self.generation = 0
        """Number that changes with every change of any leaderboard. What was made of an older one is out of date."""

    def forget(self, suite: str) -> None:
        """Drop a suite's leaderboard, because an evaluation finished or was cancelled."""
        self.generation += 1
        self._boards.pop(suite, None)

    def forget_all(self) -> None:
        """Drop all leaderboards, because the operator has hidden or deleted something."""
        self.generation += 1
        self._boards.clear()

    async def board(self, suite_id: str) -> Leaderboard:
        """Return a leaderboard. Raises NotFoundError."""
        return (await self._made(suite_id))[0]

    async def body(self, suite_id: str) -> bytes:
        """Return a leaderboard as JSON. Raises NotFoundError."""
        return (await self._made(suite_id))[1]

    async def _made(self, suite_id: str) -> tuple[Leaderboard, bytes, dict[str, Metrics]]:
        catalogue.suite(suite_id)
        async with self._lock:
            made = self._boards.get(suite_id)
            if made is None:
                generation = self.generation
                board, metrics = await self._compute(suite_id)
                made = board, (await asyncio.to_thread(board.model_dump_json)).encode(), metrics
                if generation == self.generation:
                    self._boards[suite_id] = made
        return made

    async def summaries(self) -> LeaderboardList:
        """List all leaderboards."""
        known = await self._store.finished_summary()
        summaries = []
        for suite_id in suite_ids():
            suite = load_suite(suite_id)
            entries, newest = known.get(suite_id, (0, None))
            summaries.append(
                LeaderboardSummary(
                    suite=suite_id, sha256=suite.sha256, title=suite.title, updated=_iso(newest), entries=entries
                )
            )
        return LeaderboardList(leaderboards=tuple(summaries))

    async def compare(self, suite_id: str, a: str, b: str) -> Comparison:
        """Compare two agents, each given by id or name.

        Raises NotFoundError if there is no such suite, agent or entry; InvalidRequestError for twice the same agent.
        """
        board, _, metrics = await self._made(suite_id)
        first = await self._entrant(board, "query.a", a)
        second = await self._entrant(board, "query.b", b)
        if first.agent.id == second.agent.id:
            message = f"is {second.agent.name!r}, the same agent as a; name two different agents"
            raise InvalidRequestError("query.b", message)
        sides = [Side(one.agent, metrics[str(one.evaluation)], one.why_not) for one in (first, second)]
        return await asyncio.to_thread(compare, suite_id, *sides)

    async def _entrant(self, board: Leaderboard, field: str, wanted: str) -> LeaderboardEntry:
        agent = await self._store.agent_called(wanted)
        if agent is None:
            message = f"there is no agent {wanted[:64]!r}; give an id or a name of GET /v1/agents"
            raise _unknown(ProblemType.UNKNOWN_AGENT, field, message)
        for entry in board.entries:
            if entry.agent.id == agent.id:
                return entry
        message = f"{agent.name!r} has no entry on {board.suite}; it has one after its first evaluation"
        raise _unknown(ProblemType.UNKNOWN_EVALUATION, field, message)

    async def _compute(self, suite_id: str) -> tuple[Leaderboard, dict[str, Metrics]]:
        suite = load_suite(suite_id)
        rows = []
        cancelled = await self._store.cancelled_counts(suite_id)
        newest: float | None = None
        for evaluation, agent in await self._store.first_finished(suite_id):
            if evaluation.metrics is None or evaluation.suite_sha256 != suite.sha256:
                continue
            newest = max(newest or 0.0, evaluation.finished or 0.0)
            rows.append(
                RankingInput(
                    agent=detail(agent),
                    evaluation=evaluation.id,
                    entry=Entry(evaluation.entry),
                    metrics=_metrics(evaluation.metrics),
                    cancelled=cancelled.get(agent.id, 0),
                    finished=evaluation.finished or 0.0,
                )
            )
        if suite_id not in self._algorithms:  # they do not change while the service runs
            self._algorithms[suite_id] = await asyncio.to_thread(algorithm_rows, suite)
        rows += self._algorithms[suite_id]
        entries = tuple(await asyncio.to_thread(rank, rows))
        metrics = {str(row.evaluation): row.metrics for row in rows if row.evaluation is not None}
        return Leaderboard(suite=suite_id, sha256=suite.sha256, updated=_iso(newest), entries=entries), metrics


@lru_cache(maxsize=4096)
def _metrics(stored: str) -> Metrics:
    """Return an evaluation's metrics. They never change, but a leaderboard is computed again for each newcomer."""
    return Metrics.model_validate_json(stored)


def _unknown(kind: ProblemType, field: str, message: str) -> NotFoundError:
    return NotFoundError(kind, f"{field}: {message}", errors=(FieldError(path=field, message=message),))


def _iso(seconds: float | None) -> str | None:
    return None if seconds is None else datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")
