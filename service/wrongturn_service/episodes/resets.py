"""Begins episodes, of evaluations or for practice; ends evaluations that are not driven to their end."""

import asyncio
import contextlib
import time
from collections.abc import Callable, Collection, Iterator
from typing import Final
from weakref import WeakValueDictionary

import structlog
from structlog.contextvars import bind_contextvars

from wrongturn_networks import load_suite
from wrongturn_networks.drawn import is_drawn
from wrongturn_protocol import EpisodeState, EvaluationState, ProblemType, Track, Trial, Verdict, vocabulary
from wrongturn_service.accounts import Caller
from wrongturn_service.encoding import Encoding, Reply, reset_reply
from wrongturn_service.episodes.draws import Draws
from wrongturn_service.episodes.driver import EpisodeDriver, ReplayFailedError, aborted_outcome
from wrongturn_service.episodes.episodes import PATIENCE_S, Episodes
from wrongturn_service.episodes.evaluations import RunningEvaluations, finished
from wrongturn_service.episodes.open_episode import OpenEpisode, Payer, stopping
from wrongturn_service.errors import ConflictError, ServiceError, UnavailableError, unknown
from wrongturn_service.idempotency import IdempotentRequest
from wrongturn_service.storage.evaluations import EvaluationOverError
from wrongturn_service.storage.models import EpisodeRow, EvaluationRow
from wrongturn_service.storage.store import Store
from wrongturn_service.storage.usage import reserve_of
from wrongturn_service.tokens import new_id

GRACE_S: Final = 3600.0
"""Seconds after the start in which no evaluation is closed as overdue: it may have been the service's fault."""
Origin = tuple[str, bytes]
"""Id of a fork's episode, and its packed actions up to the fork."""


class InProgress:
    """Resets in progress, by evaluation.

    An agent that is killed during a reset comes back and asks which episodes are open. It has to learn of the
    episode that is just being begun, or that episode would have no driver.
    """

    def __init__(self) -> None:
        self._resets: set[tuple[str, asyncio.Future[None]]] = set()

    @contextlib.contextmanager
    def one(self, evaluation_id: str) -> Iterator[None]:
        """Count a reset as in progress until the block ends."""
        reset = evaluation_id, asyncio.get_running_loop().create_future()
        self._resets.add(reset)
        try:
            yield
        finally:
            self._resets.discard(reset)
            reset[1].set_result(None)

    async def over(self, evaluation_id: str, patience_s: float = PATIENCE_S) -> None:
        """Wait until the evaluation's resets in progress have ended. Raises UnavailableError if they take too long."""
        begun = [over for evaluation, over in self._resets if evaluation == evaluation_id]
        if begun and (await asyncio.wait(begun, timeout=patience_s))[1]:
            raise UnavailableError(
                ProblemType.SIMULATORS_BUSY,
                f"an episode of evaluation {evaluation_id} is being begun; ask again",
                retry_after_s=1,
            )


class Resets:
    """Begins episodes."""

    def __init__(
        self,
        store: Store,
        driver: EpisodeDriver,
        evaluations: RunningEvaluations,
        episodes: Episodes,
        check_disk: Callable[[], None],
    ) -> None:
        """Use these parts. ``check_disk`` raises a ServiceError if the disk has no room for practice."""
        self.in_progress = InProgress()
        self._store = store
        self._driver = driver
        self._evaluations = evaluations
        self._episodes = episodes
        self._check_disk = check_disk

    async def next(
        self, caller: Caller, address: str, evaluation: EvaluationRow, encoding: Encoding, once: IdempotentRequest
    ) -> bytes:
        """Begin an evaluation's next trial and return the reply's body, which is stored for the request's key.

        A request that is sent again with its key keeps its place in the queue.

        Raises:
            ConflictError: The evaluation is finished or cancelled, or has no trial for now.
            UnavailableError: Its towns are being built, the service stops, the agent has too many open episodes, other
                calls come first, or no simulator works.
        """
        self._check_stopping()
        schedule = await self._evaluations.schedule(evaluation)
        if schedule.finished:
            await self._evaluations.finish_if_done(evaluation.id)
            raise finished(evaluation.id)
        limit = self._episodes.registry.max_parallel
        trial = schedule.take() if schedule.open < limit else None
        if trial is None:
            raise ConflictError(
                ProblemType.NO_TRIAL_AVAILABLE,
                f"evaluation {evaluation.id} has {schedule.open} episodes open; at most {limit} may be, and the second "
                "half of its episodes begins when the first has ended; finish one or ask again later",
                headers={"Retry-After": "1"},
            )
        try:
            body = await self._begin(caller, address, evaluation, trial, encoding, once)
        except EvaluationOverError as error:
            raise await self._over(evaluation.id) from error
        except BaseException:
            schedule.put_back(trial)
            raise
        if self._evaluations.known(evaluation.id) is not schedule:
            # The evaluation was closed before this episode could be found and ended.
            await self._episodes.drop([evaluation.id])
            raise await self._over(evaluation.id)
        return body

    async def _over(self, evaluation_id: str) -> ServiceError:
        gone = await self._store.evaluation(evaluation_id) is None
        return unknown(vocabulary.Collection.EVALUATIONS, evaluation_id) if gone else finished(evaluation_id)

    async def practise(
        self,
        caller: Caller,
        address: str,
        trial: Trial,
        encoding: Encoding,
        once: IdempotentRequest,
        origin: Origin | None = None,
    ) -> bytes:
        """Begin a practice episode and return the reply's body. Arguments and errors as for :meth:`next`.

        ``origin`` is what a fork comes from.

        Raises:
            EpisodeRefusedError: The simulation refuses the trial.
            QuotaReachedError: The owner, or its address, has too many bytes stored.
            ServiceError: The disk is nearly full, and this is no check of a submission.
        """
        self._check_stopping()
        if caller.submission is None:
            self._check_disk()
        await self._store.check_room(caller.owner, reserve_of(1, caller.rig, journeys=trial.journey is not None))
        return await self._begin(caller, address, None, trial, encoding, once, origin)

    def _check_stopping(self) -> None:
        if self._episodes.stopping:
            raise stopping()

    async def _begin(
        self,
        caller: Caller,
        address: str,
        evaluation: EvaluationRow | None,
        trial: Trial,
        encoding: Encoding,
        once: IdempotentRequest,
        origin: Origin | None = None,
    ) -> bytes:
        registry, practice = self._episodes.registry, evaluation is None
        payer = Payer(caller.holder, caller.owner, None if caller.submission is not None else address)
        registry.reserve(payer, practice=practice)
        try:
            return await self._open(caller, payer, evaluation, trial, encoding, once, origin)
        except BaseException:
            registry.give_back(payer, practice=practice)
            raise

    async def _open(
        self,
        caller: Caller,
        payer: Payer,
        evaluation: EvaluationRow | None,
        trial: Trial,
        encoding: Encoding,
        once: IdempotentRequest,
        origin: Origin | None,
    ) -> bytes:
        track, sight, practice, episode_id = caller.track, caller.sight, evaluation is None, new_id("ep")
        of = None if evaluation is None else evaluation.id
        counts = evaluation is None or evaluation.driven is not None
        bind_contextvars(episode=episode_id, evaluation=of)

        def reply(observation: bytes) -> Reply:
            return reset_reply(
                episode_id,
                observation,
                encoding,
                sight,
                # A drawn town's name would build the town.
                town=trial.town if practice or (track is Track.PRIVILEGED and not is_drawn(trial.town)) else None,
                trial=trial.id if practice else None,
                lease_s=self._episodes.abort_s,
            )

        episode = OpenEpisode(episode_id, payer, of, trial, sight, reply(b""), self._episodes.clock(), counts)
        if origin is not None:
            episode.origin, episode.expected = origin
        async with episode.lock:
            try:
                result = await self._driver.begin(episode, encoding, f"{of} {once.key}")
            except ReplayFailedError as error:
                raise UnavailableError(ProblemType.SIMULATOR_FAILED, f"{error}; try again", retry_after_s=5) from error
            episode.last = reply(result.observation)
            body = episode.last.render(encoding)
            row = EpisodeRow(
                id=episode_id,
                evaluation_id=of,
                agent_id=caller.id,
                trial_id=trial.id,
                trial=trial.model_dump_json(),
                track=track.value,
                state=EpisodeState.OPEN.value,
                created=time.time(),
                steps=0,
                origin_id=episode.origin,
                stored_bytes=reserve_of(1, caller.rig, journeys=trial.journey is not None) if practice else 0,
            )
            try:
                await self._store.add_episode(row, once.row(body, 201, encoding))
            except BaseException:
                await self._driver.detach(episode)
                raise
            episode.heard = self._episodes.clock()
            self._episodes.registry[episode_id] = episode
        return body


class Closings:
    """Closes evaluations for their agents, and overdue ones by itself."""

    def __init__(
        self,
        store: Store,
        evaluations: RunningEvaluations,
        draws: Draws,
        episodes: Episodes,
        idle_s: float,
        longest_s: float,
        clock: Callable[[], float] = time.time,
    ) -> None:
        """Close evaluations ``idle_s`` after their last reset or step, and ``longest_s`` after their begin.

        Otherwise one step a day would keep a bad one from ever becoming an entry.
        """
        self._store = store
        self._evaluations = evaluations
        self._draws = draws
        self._episodes = episodes
        self._idle_s = idle_s
        self._longest_s = longest_s
        self._clock = clock
        self._began = clock()
        self._locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()
        self._log = structlog.get_logger("evaluations")

    async def close(self, evaluation_id: str) -> None:
        """Close a running evaluation. Safe to call again.

        Before its first step it is deleted. Later every trial without a verdict counts as ``aborted``, and the
        evaluation is finished. If that fails half-way, another call or the next start goes on with it.
        """
        lock = self._locks.setdefault(evaluation_id, asyncio.Lock())
        async with lock:
            evaluation = await self._store.evaluation(evaluation_id)
            if evaluation is None or evaluation.state != EvaluationState.RUNNING:
                return
            if await self._store.delete_undriven(evaluation_id):
                self._evaluations.drop(evaluation_id)
                await self._episodes.drop([evaluation_id])
                self._log.info("evaluation deleted before its first step", evaluation=evaluation_id)
                return
            with self._evaluations.closing(evaluation_id):
                await self._episodes.abort_evaluation(evaluation_id)
                await self._store.abort_rest(evaluation_id, await self._aborted(evaluation))
                self._evaluations.drop(evaluation_id)
                await self._episodes.drop([evaluation_id])
            self._log.info("evaluation closed", evaluation=evaluation_id)
            # From here on every trial has a verdict. The next start finishes the evaluation if this one fails.
            await self._evaluations.finish_closed(evaluation_id)

    async def drop(self, evaluations: Collection[str], holders: Collection[str]) -> None:
        """Let go of what was deleted in the database: evaluations, and agents and submissions whose practice ends."""
        for evaluation_id in evaluations:
            self._evaluations.drop(evaluation_id)
        await self._episodes.drop(evaluations, holders)

    async def close_overdue(self, spared: Collection[str] = ()) -> None:
        """Close the evaluations whose agents were idle for too long, and those that were begun too long ago.

        ``spared`` are those that the service itself drives: if one is idle, its agent is not to blame.
        """
        now = self._clock()
        if now - self._began < min(self._idle_s, GRACE_S):
            return
        for evaluation_id, begun, active in await self._store.running_since():
            if evaluation_id in spared:
                continue
            idle_s = now - active
            for episode in self._episodes.registry.of(evaluation_id):
                idle_s = min(idle_s, self._episodes.silence_s(episode))
            if idle_s >= self._idle_s or now - begun >= self._longest_s:
                self._log.warning("evaluation overdue", evaluation=evaluation_id, idle_s=int(idle_s))
                try:
                    await self.close(evaluation_id)
                except Exception:
                    self._log.exception("evaluation could not be closed", evaluation=evaluation_id)

    async def _aborted(self, evaluation: EvaluationRow) -> list[EpisodeRow]:
        """Return an episode for each trial and twin that ended before it began."""
        agent = await self._store.agent(evaluation.agent_id)
        if agent is None:  # deleted meanwhile
            return []
        now = self._clock()
        return [
            EpisodeRow(
                id=new_id("ep"),
                evaluation_id=evaluation.id,
                agent_id=evaluation.agent_id,
                trial_id=trial.id,
                trial=trial.model_dump_json(),
                track=agent.track,
                state=EpisodeState.FINISHED.value,
                created=now,
                finished=now,
                verdict=Verdict.ABORTED.value,
                outcome=aborted_outcome(trial, 0.0).model_dump_json(),
                steps=0,
            )
            for trial in self._draws.get(load_suite(evaluation.suite), evaluation.secret).episodes
        ]
