"""Leaderboards. Each is computed again after an evaluation of its suite has finished."""

import asyncio
from datetime import UTC, datetime

from wrongturn_networks import load_suite, suite_ids
from wrongturn_protocol import Entry, Leaderboard, LeaderboardList, LeaderboardSummary, Metrics
from wrongturn_service import catalogue
from wrongturn_service.accounts import detail
from wrongturn_service.storage.store import Store


class Leaderboards:
    """Leaderboards by suite."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._bodies: dict[str, bytes] = {}
        self._generation = 0
        self._lock = asyncio.Lock()

    def forget(self, suite: str) -> None:
        """Drop a suite's leaderboard, because an evaluation finished or was cancelled."""
        self._generation += 1
        self._bodies.pop(suite, None)

    async def body(self, suite_id: str) -> bytes:
        """Return a leaderboard as JSON. Raises NotFoundError."""
        catalogue.suite(suite_id)
        async with self._lock:
            body = self._bodies.get(suite_id)
            if body is None:
                generation = self._generation
                body = (await self._compute(suite_id)).model_dump_json().encode()
                if generation == self._generation:
                    self._bodies[suite_id] = body
        return body

    async def summaries(self) -> LeaderboardList:
        """List all leaderboards."""
        known = await self._store.finished_summary()
        summaries = []
        for suite_id in suite_ids():
            suite = load_suite(suite_id)
            entries, newest = known.get(suite_id, (0, None))
            summaries.append(
                LeaderboardSummary(
                    suite=suite_id,
                    sha256=suite.sha256,
                    title=suite.title,
                    updated=_iso(newest),
                    entries=entries,
                ),
            )
        return LeaderboardList(leaderboards=tuple(summaries))

    async def _compute(self, suite_id: str) -> Leaderboard:
        from wrongturn_service.evaluation.ranking import RankingInput, rank  # noqa: PLC0415 - statistics are heavy

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
                    outcomes=await self._store.outcomes(evaluation.id),
                    metrics=Metrics.model_validate_json(evaluation.metrics),
                    cancelled=cancelled.get(agent.id, 0),
                ),
            )
        entries = await asyncio.to_thread(rank, suite, rows)
        return Leaderboard(suite=suite_id, sha256=suite.sha256, updated=_iso(newest), entries=tuple(entries))


def _iso(seconds: float | None) -> str | None:
    return None if seconds is None else datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")
