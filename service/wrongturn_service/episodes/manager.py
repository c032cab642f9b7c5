"""Episodes from their reset to their verdict. Nothing here knows of HTTP; what it refuses is a ServiceError."""

import asyncio
import contextlib
import time
import zlib
from collections import Counter
from collections.abc import Callable

import structlog
from sqlalchemy.exc import SQLAlchemyError
from structlog.contextvars import bind_contextvars

from wrongturn_protocol import (
    EpisodeState,
    EvaluationState,
    ProblemType,
    StepRequest,
    Track,
    Trial,
    Verdict,
)
from wrongturn_service.episodes import refusals
from wrongturn_service.episodes.driver import Driver, ReplayFailedError
from wrongturn_service.episodes.lease import Lease, Standing, Terms
from wrongturn_service.episodes.open_episode import ACTION, OpenEpisode, as_float32
from wrongturn_service.episodes.replies import step_reply_of, stored_reply
from wrongturn_service.episodes.running import RunningEvaluations, cancelled
from wrongturn_service.episodes.running import finished as evaluation_finished
from wrongturn_service.errors import ConflictError, GoneError, UnavailableError
from wrongturn_service.pool.pool import Action
from wrongturn_service.storage.models import EpisodeRow, EvaluationRow, IdempotencyRow
from wrongturn_service.storage.store import Store
from wrongturn_service.telemetry import Telemetry
from wrongturn_service.tokens import new_id
from wrongturn_service.wire import Reply, Wire, reset_reply

Remember = Callable[[bytes], IdempotencyRow] | None
"""Makes of a reply what is stored for its idempotency key; None where the request had no key."""


class EpisodeManager:
    """The open episodes, in memory; the finished ones, in the database."""

    def __init__(
        self,
        store: Store,
        driver: Driver,
        evaluations: RunningEvaluations,
        *,
        terms: Terms,
        parallel: int,
        practice: int,
        telemetry: Telemetry | None = None,
    ) -> None:
        """No episode is open yet.

        Args:
            store: where finished ones go.
            driver: what moves them.
            evaluations: what hands out trials.
            terms: how long agents may be silent.
            parallel: open episodes of one evaluation at most.
            practice: open practice episodes of one agent at most.
            telemetry: what is told of episodes' ends.
        """
        self.stopping = False
        """Whether new episodes are refused."""
        self._store = store
        self._driver = driver
        self._evaluations = evaluations
        self._terms = terms
        self._parallel = parallel
        self._practice = practice
        self._telemetry = telemetry or Telemetry()
        self._practising: Counter[str] = Counter()
        self._open: dict[str, OpenEpisode] = {}
        self._background: set[asyncio.Task[None]] = set()
        self._log = structlog.get_logger("episodes")

    @property
    def open(self) -> int:
        """How many episodes are open."""
        return len(self._open)

    @property
    def held(self) -> int:
        """How many of them have a simulator; the others' is rebuilt when their agent comes back."""
        return sum(episode.simulator is not None for episode in self._open.values())

    async def stop(self) -> None:
        """Give up what goes on in the background; open episodes are marked as lost at the next start."""
        self.stopping = True
        for task in self._background:
            task.cancel()
        await asyncio.gather(*self._background, return_exceptions=True)

    # Reset

    async def open_next(self, evaluation: EvaluationRow, track: Track, wire: Wire, remember: Remember) -> bytes:
        """The reset of an evaluation's next trial: the reply's body.

        Raises:
            ConflictError: finished, cancelled, or no trial can be had for now.
            UnavailableError: no simulator is free, or none works.
        """
        self._check_stopping()
        schedule = await self._evaluations.schedule(evaluation)
        if schedule.finished:
            await self._evaluations.finish_if_done(evaluation.id)
            raise evaluation_finished(evaluation.id)
        trial = schedule.take() if schedule.open < self._parallel else None
        if trial is None:
            raise ConflictError(
                ProblemType.NO_TRIAL_AVAILABLE,
                f"{schedule.open} episodes of evaluation {evaluation.id} are open, at most {self._parallel} may be, "
                "and a trial and its twin never are at the same time; finish one, or ask again later",
                headers={"Retry-After": "1"},
            )
        try:
            body = await self._begin(evaluation.agent_id, evaluation.id, trial, track, wire, remember)
        except BaseException:
            schedule.put_back(trial)
            raise
        if self._evaluations.known(evaluation.id) is not schedule:
            # It was cancelled meanwhile, before this episode was there to be ended with it.
            await self.cancel(evaluation.id)
            raise cancelled(evaluation.id)
        return body

    async def open_practice(self, agent: str, trial: Trial, track: Track, wire: Wire, remember: Remember) -> bytes:
        """The reset of a practice episode: the reply's body.

        Raises:
            EpisodeRefusedError: the simulation does not admit the trial.
            UnavailableError: the agent has too many open, no simulator is free, or none works.
        """
        self._check_stopping()
        if self._practising[agent] >= self._practice:
            raise UnavailableError(
                ProblemType.RATE_LIMITED,
                f"{self._practice} practice episodes of this agent are open; finish one, or DELETE it",
                status=429,
            )
        self._practising[agent] += 1
        try:
            return await self._begin(agent, None, trial, track, wire, remember)
        except BaseException:
            self._practising[agent] -= 1
            raise

    async def _begin(
        self,
        agent: str,
        evaluation: str | None,
        trial: Trial,
        track: Track,
        wire: Wire,
        remember: Remember,
    ) -> bytes:
        practice = evaluation is None
        episode_id = new_id("ep")
        bind_contextvars(episode=episode_id, evaluation=evaluation)
        lease = Lease(self._terms)

        def reply(observation: bytes) -> Reply:
            return reset_reply(
                episode_id,
                observation,
                wire,
                track,
                town=trial.town if practice or track is Track.PRIVILEGED else None,
                trial=trial.id if practice else None,
                lease_s=self._terms.abort_s,
            )

        episode = OpenEpisode(episode_id, agent, evaluation, trial, track, reply(b""), lease)
        async with episode.lock:
            try:
                frame = await self._driver.begin(episode, wire)
            except ReplayFailedError as error:
                raise UnavailableError(ProblemType.SIMULATOR_FAILED, f"{error}; try again", retry_after_s=5) from error
            episode.last = reply(frame.observation)
            body = episode.last.render(wire)
            row = EpisodeRow(
                id=episode_id,
                evaluation_id=evaluation,
                agent_id=agent,
                trial_id=trial.id,
                trial=trial.model_dump_json(),
                track=track.value,
                state=EpisodeState.OPEN.value,
                created=time.time(),
                steps=0,
            )
            try:
                await self._store.add_episode(row, remember(body) if remember is not None else None)
            except BaseException:
                await self._driver.detach(episode)
                raise
            lease.renew()
            self._open[episode_id] = episode
        return body

    # Step

    async def step(self, agent: str, episode_id: str, request: StepRequest, wire: Wire) -> bytes:
        """One step: the reply's body.

        Raises:
            NotFoundError, ForbiddenError, GoneError, ConflictError, UnavailableError.
        """
        action = as_float32(request.action)
        episode = self._open.get(episode_id)
        if episode is None:
            return await self._stored_step(agent, episode_id, request.seq, action, wire)
        refusals.check_owner(agent, episode.agent, episode_id)
        bind_contextvars(episode=episode_id, evaluation=episode.evaluation)
        async with episode.lock:
            episode.lease.renew()
            if episode.closed:
                return await self._stored_step(agent, episode_id, request.seq, action, wire)
            if request.seq == episode.seq:
                refusals.check_same(episode_id, request.seq, action, episode.last_action)
            elif episode.end is not None:
                raise refusals.episode_finished(episode_id)
            elif request.seq != episode.seq + 1:
                raise refusals.gap(episode_id, request.seq, episode.seq)
            else:
                await self._advance(episode, action, wire)
            if episode.end is not None:
                await self._settle(episode)
            episode.lease.renew()
            return episode.last.render(wire)

    async def _advance(self, episode: OpenEpisode, action: Action, wire: Wire) -> None:
        try:
            frame = await self._driver.step(episode, action, wire)
        except ReplayFailedError as error:
            await self._invalidate(episode)
            raise GoneError(
                f"episode {episode.id}: {error}, so it counts as invalid and its trial runs again; ask for the next",
            ) from error
        episode.actions += ACTION.pack(*action)
        episode.last = step_reply_of(episode, frame, wire)
        episode.end = frame.final
        if frame.final is not None:
            await self._driver.detach(episode)

    async def _stored_step(self, agent: str, episode_id: str, seq: int, action: Action, wire: Wire) -> bytes:
        """A step of an episode that is no longer open: the last one's repeat, or an error."""
        row = await self._row(agent, episode_id)
        if row.state != EpisodeState.FINISHED:
            raise await self._lost(row)
        if seq == row.steps and row.last_action is not None and row.last_reply is not None:
            steer, throttle, brake = ACTION.unpack(row.last_action)
            refusals.check_same(episode_id, seq, action, (steer, throttle, brake))
            return stored_reply(row, zlib.decompress(row.last_reply)).render(wire)
        raise refusals.episode_finished(episode_id)

    # Other calls of the owner

    async def look(self, agent: str | None, episode_id: str) -> tuple[OpenEpisode | None, EpisodeRow]:
        """An episode as the owner may see it: from memory while it is open, and always its row.

        Raises:
            NotFoundError.
        """
        episode = self._open.get(episode_id)
        if episode is not None and episode.agent == agent:
            episode.lease.renew()
        row = await self._store.episode(episode_id)
        if row is None:
            raise refusals.unknown_episode(episode_id)
        return self._open.get(episode_id), row

    def last_reply(self, episode_id: str, wire: Wire) -> tuple[int, bytes] | None:
        """Sequence number and body of an open episode's last reply."""
        episode = self._open.get(episode_id)
        return None if episode is None else (episode.seq, episode.last.render(wire))

    async def abort(self, agent: str, episode_id: str) -> None:
        """End an episode as ``aborted``; again is no harm.

        Raises:
            ConflictError: it has another verdict.
            NotFoundError, ForbiddenError, GoneError.
        """
        episode = self._open.get(episode_id)
        if episode is not None:
            refusals.check_owner(agent, episode.agent, episode_id)
            await self._abort(episode)
        row = await self._row(agent, episode_id)
        if row.state != EpisodeState.FINISHED:
            raise await self._lost(row)
        if row.verdict != Verdict.ABORTED:
            raise refusals.episode_finished(episode_id)

    async def cancel(self, evaluation_id: str) -> None:
        """Cancel an evaluation; its open episodes end without a verdict."""
        await self._store.cancel_evaluation(evaluation_id)
        self._evaluations.drop(evaluation_id)
        for episode in [episode for episode in self._open.values() if episode.evaluation == evaluation_id]:
            async with episode.lock:
                if not episode.closed:
                    self._telemetry.voided("cancelled")
                await self._close(episode)

    # Leases

    async def watch_leases(self) -> None:
        """Look after silent agents until cancelled."""
        while True:
            await asyncio.sleep(self._terms.period_s)
            for episode in list(self._open.values()):
                if episode.lock.locked():
                    continue
                standing = episode.lease.standing
                if episode.end is not None:
                    self._spawn(self._settle_again(episode))
                elif standing is Standing.EXPIRED:
                    self._telemetry.expired.inc()
                    self._spawn(self._abort(episode))
                elif standing is Standing.RELEASE and episode.simulator is not None:
                    self._spawn(self._release(episode))

    async def _release(self, episode: OpenEpisode) -> None:
        async with episode.lock:
            if episode.lease.standing is not Standing.HELD:
                await self._driver.detach(episode)

    def _spawn(self, work: "asyncio._CoroutineLike[None]") -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._background.add(task)
        task.add_done_callback(self._done)

    def _done(self, task: "asyncio.Task[None]") -> None:
        self._background.discard(task)
        if not task.cancelled() and task.exception() is not None:
            self._log.error("background work failed", reason=repr(task.exception()))

    async def _settle_again(self, episode: OpenEpisode) -> None:
        async with episode.lock:
            if not episode.closed:
                with contextlib.suppress(SQLAlchemyError):
                    await self._settle(episode)

    async def _abort(self, episode: OpenEpisode) -> None:
        async with episode.lock:
            if episode.closed:
                return
            if episode.end is None:
                episode.end = await self._driver.abort(episode)
                await self._driver.detach(episode)
            await self._settle(episode)

    # Ends

    async def _settle(self, episode: OpenEpisode) -> None:
        """Store an episode's end; only then is it told. Raises SQLAlchemy's errors, and can be called again."""
        end = episode.end
        assert end is not None
        values = {
            "verdict": end.outcome.verdict.value,
            "outcome": end.outcome.model_dump_json(),
            "steps": end.steps,
            "actions_sha256": end.actions_sha256 or None,
            "trajectory_sha256": end.trajectory_sha256 or None,
            "last_action": bytes(episode.actions[-ACTION.size :]) or None,
            "last_reply": zlib.compress(episode.last.render(Wire.JSON)) if episode.seq else None,
        }
        stored = await self._store.finish_episode(episode.id, values, end.trajectory, end.trajectory_sha256)
        await self._close(episode)
        if stored:
            self._telemetry.ended(scored=episode.evaluation is not None, verdict=end.outcome.verdict.value)
        if episode.evaluation is None:
            return
        if not stored:
            raise cancelled(episode.evaluation)
        self._log.info("episode finished", episode=episode.id, evaluation=episode.evaluation, steps=end.steps)
        schedule = self._evaluations.known(episode.evaluation)
        if schedule is not None:
            schedule.finish(episode.trial)
            await self._evaluations.finish_if_done(episode.evaluation)

    async def _invalidate(self, episode: OpenEpisode) -> None:
        """The infrastructure failed: no verdict that counts, and the trial runs again."""
        self._log.error("episode invalid", episode=episode.id, trial=episode.trial.id)
        self._telemetry.voided("simulators-failed")
        await self._store.lose_episode(episode.id, Verdict.INVALID)
        await self._close(episode)
        if episode.evaluation is not None:
            schedule = self._evaluations.known(episode.evaluation)
            if schedule is not None:
                schedule.put_back(episode.trial)

    async def _close(self, episode: OpenEpisode) -> None:
        if episode.closed:
            return
        episode.closed = True
        self._open.pop(episode.id, None)
        if episode.practice:
            self._practising[episode.agent] -= 1
        await self._driver.detach(episode)

    # Small things

    async def _row(self, agent: str, episode_id: str) -> EpisodeRow:
        row = await self._store.episode(episode_id)
        if row is None:
            raise refusals.unknown_episode(episode_id)
        refusals.check_owner(agent, row.agent_id, episode_id)
        return row

    async def _lost(self, row: EpisodeRow) -> GoneError | ConflictError:
        if row.evaluation_id is not None:
            evaluation = await self._store.evaluation(row.evaluation_id)
            if evaluation is not None and evaluation.state == EvaluationState.CANCELLED:
                return cancelled(row.evaluation_id)
        why = "its simulators failed" if row.verdict == Verdict.INVALID else "the service was started again meanwhile"
        return GoneError(f"episode {row.id} is lost: {why}; nobody is charged, ask for the next trial")

    def _check_stopping(self) -> None:
        if self.stopping:
            raise UnavailableError(ProblemType.SHUTTING_DOWN, "the service is stopping", retry_after_s=5)
