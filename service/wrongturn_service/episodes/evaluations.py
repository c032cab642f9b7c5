"""Running evaluations: the order of their trials, and their metrics once every trial has a verdict."""

import asyncio
import contextlib
import json
import platform
import secrets
import time
from collections.abc import Callable, Iterable, Iterator
from importlib.metadata import version
from typing import Final
from weakref import WeakValueDictionary

import structlog

from wrongturn_networks import Draw, Suite, load_suite
from wrongturn_networks.draws import halves
from wrongturn_protocol import Entry, EpisodeState, EvaluationState, ProblemType, Rig, Track, Trial
from wrongturn_protocol.vocabulary import Collection
from wrongturn_service.episodes.draws import Draws
from wrongturn_service.errors import ConflictError, InvalidRequestError, UnavailableError, unknown
from wrongturn_service.storage.models import EvaluationRow
from wrongturn_service.storage.store import Store
from wrongturn_service.storage.usage import reserve_of
from wrongturn_service.telemetry import Telemetry
from wrongturn_service.tokens import new_id

_PACKAGES: Final = ("libsumo", "numba", "numpy", "scipy", "wrongturn-client", "wrongturn-networks", "wrongturn-service")
"""Packages whose versions decide what is driven, seen and judged."""


class Schedule:
    """An evaluation's trials: pending, open or finished.

    The first half has one of each pair. The second begins when the first has ended, so a trial and its twin are never
    open together, and an agent cannot find out which episodes are a pair by holding one open.
    """

    def __init__(self, draw: Draw, secret: str, finished: Iterable[str] = ()) -> None:
        """Order the trials by the secret alone, so that a restart changes nothing.

        ``finished`` are the ids of those that have a verdict.
        """
        done = frozenset(finished)
        self._halves = [[trial for trial in half if trial.id not in done] for half in halves(draw, secret)]
        self._open: dict[str, Trial] = {}

    @property
    def open(self) -> int:
        """Number of trials that are being driven."""
        return len(self._open)

    @property
    def finished(self) -> bool:
        """Whether every trial has a verdict."""
        return not any(self._halves) and not self._open

    def take(self) -> Trial | None:
        """Open the next trial and return it. None while the last of a half are being driven."""
        if not self._halves[0] and not self._open:
            self._halves = [self._halves[1], []]
        if not self._halves[0]:
            return None
        trial = self._halves[0].pop(0)
        self._open[trial.id] = trial
        return trial

    def put_back(self, trial: Trial) -> None:
        """Return an open trial, so that it runs again."""
        if self._open.pop(trial.id, None) is not None:
            self._halves[0].insert(0, trial)

    def finish(self, trial: Trial) -> None:
        """Note that an open trial has its verdict."""
        self._open.pop(trial.id, None)


class RunningEvaluations:
    """Schedules of running evaluations. Each is made from the database when it is first needed."""

    def __init__(self, store: Store, telemetry: Telemetry, draws: Draws, on_finished: Callable[[str], None]) -> None:
        """Create the collection without schedules. ``on_finished`` gets the suite of each evaluation that finishes."""
        self._store = store
        self._draws = draws
        self._unprepared: set[str] = set()
        """Evaluations from before the start whose towns are being built."""
        self._telemetry = telemetry
        self._on_finished = on_finished
        self._closing: set[str] = set()
        self._schedules: dict[str, Schedule] = {}
        # A lock lives as long as somebody holds it or waits for it.
        self._locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()
        self._log = structlog.get_logger("evaluations")

    async def schedule(self, evaluation: EvaluationRow) -> Schedule:
        """Return an evaluation's schedule.

        Raises:
            ConflictError: The evaluation is finished or cancelled, or its suite has changed.
            UnavailableError: Its towns are being built.
        """
        if evaluation.state == EvaluationState.CANCELLED:
            raise cancelled(evaluation)
        if evaluation.state == EvaluationState.FINISHED:
            raise finished(evaluation.id)
        async with self._lock(evaluation.id):
            if evaluation.id in self._closing:
                raise finished(evaluation.id)
            found = self._schedules.get(evaluation.id)
            if found is None:
                suite = load_suite(evaluation.suite)
                if suite.sha256 != evaluation.suite_sha256:
                    raise ConflictError(
                        ProblemType.EVALUATION_CANCELLED,
                        f"evaluation {evaluation.id}: {evaluation.suite} has changed since the evaluation began; "
                        "begin another",
                    )
                draw = self._draws.get(suite, evaluation.secret)
                done = await self._store.trials_by_state(evaluation.id)
                found = Schedule(draw, evaluation.secret, done[EpisodeState.FINISHED])
                self._schedules[evaluation.id] = found
                # A closing from now on finds this schedule and drops it. One that came before is seen here.
                newest = await self._store.evaluation(evaluation.id)
                if newest is None or newest.state != EvaluationState.RUNNING or evaluation.id in self._closing:
                    self.drop(evaluation.id)
                    raise unknown(Collection.EVALUATIONS, evaluation.id) if newest is None else finished(evaluation.id)
        return found

    def _lock(self, evaluation_id: str) -> asyncio.Lock:
        return self._locks.setdefault(evaluation_id, asyncio.Lock())

    def known(self, evaluation_id: str | None) -> Schedule | None:
        """Return the schedule if it was made already; None for practice too."""
        return self._schedules.get(evaluation_id or "")

    def drop(self, evaluation_id: str) -> None:
        """Forget the schedule of an evaluation that is closed."""
        self._schedules.pop(evaluation_id, None)

    @contextlib.contextmanager
    def closing(self, evaluation_id: str) -> Iterator[None]:
        """Hand out no more trials of an evaluation while the block closes it."""
        self._closing.add(evaluation_id)
        try:
            yield
        finally:
            self._closing.discard(evaluation_id)

    async def finish_closed(self, evaluation_id: str) -> None:
        """Compute and store the metrics of a closed evaluation. A failure is logged and repeated later."""
        evaluation = await self._store.evaluation(evaluation_id)
        if evaluation is not None and evaluation.state == EvaluationState.RUNNING:
            await self.schedule(evaluation)
            await self.finish_if_done(evaluation_id)

    async def finish_if_done(self, evaluation_id: str) -> None:
        """Compute and store the metrics once every trial has a verdict. A failure is logged and repeated later."""
        schedule = self._schedules.get(evaluation_id)
        if schedule is None or not schedule.finished:
            return
        async with self._lock(evaluation_id):
            if self._schedules.get(evaluation_id) is not schedule:
                return
            try:
                await self._finish(evaluation_id)
            except Exception:
                self._log.exception("metrics failed", evaluation=evaluation_id)
                return
            self.drop(evaluation_id)

    async def resume(self) -> None:
        """Finish evaluations whose last verdict was stored before the service stopped."""
        for evaluation in await self._store.running_evaluations():
            await self._resume(evaluation)

    async def _resume(self, evaluation: EvaluationRow) -> None:
        self._unprepared.discard(evaluation.id)
        try:
            await self.schedule(evaluation)
            await self.finish_if_done(evaluation.id)
        except UnavailableError:
            self._unprepared.add(evaluation.id)
        except Exception:
            self._log.exception("evaluation cannot go on", evaluation=evaluation.id)

    async def retry(self) -> None:
        """Finish evaluations whose metrics failed, and go on with those whose towns are built by now."""
        for evaluation_id in list(self._unprepared):
            evaluation = await self._store.evaluation(evaluation_id)
            if evaluation is None or evaluation.state != EvaluationState.RUNNING:
                self._unprepared.discard(evaluation_id)
            else:
                await self._resume(evaluation)
        for evaluation_id in list(self._schedules):
            await self.finish_if_done(evaluation_id)

    async def _finish(self, evaluation_id: str) -> None:
        evaluation = await self._store.evaluation(evaluation_id)
        if evaluation is None:  # deleted meanwhile
            return
        outcomes = await self._store.outcomes(evaluation_id)
        draw = self._draws.get(load_suite(evaluation.suite), evaluation.secret)

        def compute() -> str:
            from wrongturn_judge import metrics  # noqa: PLC0415 - statistics are heavy, and rarely needed

            return metrics.compute(draw, outcomes).model_dump_json()

        # Statistics take a while; in a thread they do not hold up other agents.
        versions = json.dumps({"python": platform.python_version(), **{name: version(name) for name in _PACKAGES}})
        if await self._store.finish_evaluation(evaluation_id, await asyncio.to_thread(compute), versions):
            for outcome in outcomes.values():
                self._telemetry.ended.labels("true", outcome.verdict.value).inc()
        self._log.info("evaluation finished", evaluation=evaluation_id, suite=evaluation.suite)
        self._on_finished(evaluation.suite)


def new_evaluation(suite: Suite, agent: str, track: Track, rig: Rig | None, entry: Entry) -> EvaluationRow:
    """Return the row of a new evaluation with a secret of its own. Raises as :func:`check_takes`."""
    check_takes(suite, track)
    return EvaluationRow(
        id=new_id("ev"),
        agent_id=agent,
        suite=suite.id,
        suite_sha256=suite.sha256,
        entry=entry.value,
        state=EvaluationState.RUNNING.value,
        secret=secrets.token_hex(32),
        trials=sum(suite.counts),
        created=time.time(),
        stored_bytes=reserve_of(sum(suite.counts), rig, journeys=suite.of_journeys),
    )


def check_takes(suite: Suite, track: Track | None) -> None:
    """Check whether a suite takes a new evaluation of an agent's track, None if the track is not known yet.

    Raises:
        InvalidRequestError: The suite does not take agents of the track.
    """
    if track is not None and track not in suite.tracks:
        tracks = ", ".join(suite.tracks)
        raise InvalidRequestError(
            "suite",
            f"{suite.id} takes agents of the tracks {tracks}; this agent's track is {track}",
            ProblemType.TRACK_NOT_AVAILABLE,
        )


def cancelled(evaluation: EvaluationRow) -> ConflictError:
    """Return the error for calls on a cancelled evaluation."""
    return ConflictError(
        ProblemType.EVALUATION_CANCELLED,
        f"evaluation {evaluation.id} was cancelled; begin another by POST /v1/evaluations",
    )


def finished(evaluation_id: str) -> ConflictError:
    """Return the error for calls on a finished evaluation."""
    return ConflictError(
        ProblemType.EVALUATION_FINISHED, f"evaluation {evaluation_id} is finished; GET it to see its metrics"
    )
