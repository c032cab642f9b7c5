"""Open episodes: steps, views and ends. This module knows nothing of HTTP; it refuses calls with a ServiceError.

Only open episodes are in memory; finished ones are in the database. A verdict is stored before anybody learns of it.
"""

import asyncio
import contextlib
import time
import zlib
from collections.abc import Callable, Collection, Coroutine
from functools import partial
from typing import Any, Final

import orjson
import structlog
from sqlalchemy.exc import SQLAlchemyError
from structlog.contextvars import bind_contextvars

from wrongturn_protocol import EpisodeState, EvaluationState, Sight, StepRequest, Verdict
from wrongturn_service import logs
from wrongturn_service.accounts import Caller
from wrongturn_service.encoding import Encoding, Reply, step_reply
from wrongturn_service.episodes.driver import EpisodeDriver, ReplayFailedError, aborted_end
from wrongturn_service.episodes.evaluations import RunningEvaluations, cancelled, finished
from wrongturn_service.episodes.open_episode import (
    OpenEpisode,
    Registry,
    check_same,
    check_view,
    episode_finished,
    unknown_episode,
)
from wrongturn_service.errors import ConflictError, GoneError, UnavailableError
from wrongturn_service.simulators.interface import ACTION, Action, StepResult, rounded
from wrongturn_service.storage.models import EpisodeRow
from wrongturn_service.storage.store import Store
from wrongturn_service.telemetry import Telemetry, Voided

PATIENCE_S: Final = 20.0
"""Seconds to wait for resets in progress; less than a client waits for a reply."""
LEASES_EVERY_S: Final = 1.0
"""Seconds between two looks at the leases; less if one is shorter than four times that."""
IDLE_S: Final = 1.0
"""Seconds without a call after which the simulator of practice, or of a mere reset, goes to a call that waits."""
_LOOK_S: Final = 0.02
_LOOKED_UP: Final = 4
"""Episodes that are looked up in the database at a time. More at once would only delay everything else."""
Done = Callable[[Reply | Exception, float | None], None]
"""Called with a step's reply or error, and with the simulator's seconds unless telemetry has them already."""


class Episodes:
    """Steps, views and ends of open episodes. Methods that begin with an underscore need the episode's lock."""

    def __init__(
        self,
        store: Store,
        driver: EpisodeDriver,
        evaluations: RunningEvaluations,
        registry: Registry,
        telemetry: Telemetry,
        *,
        release_s: float,
        abort_s: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin without open episodes.

        An agent that is silent for ``release_s`` seconds loses its simulator, which is rebuilt when it comes back.
        After ``abort_s`` seconds its episode ends as ``aborted``.
        """
        self.registry = registry
        self.abort_s = abort_s
        self.clock = clock
        self.stopping = False
        """Whether new episodes are refused."""
        self._store = store
        self._driver = driver
        self._evaluations = evaluations
        self._release_s = release_s
        self._telemetry = telemetry
        self._looking_up = asyncio.Semaphore(_LOOKED_UP)
        self._tasks: set[asyncio.Task[None]] = set()
        self._log = structlog.get_logger("episodes")
        driver.make_room = self._make_room

    @property
    def open(self) -> int:
        """Number of open episodes."""
        return len(self.registry)

    @property
    def held(self) -> int:
        """Number of open episodes that have a simulator."""
        return sum(episode.simulator is not None for episode in self.registry.values())

    def silence_s(self, episode: OpenEpisode) -> float:
        """Return the seconds since an open episode's last call; 0 while one is being answered."""
        return 0.0 if episode.lock.locked() else self.clock() - episode.heard

    def driven(self, within_s: float) -> int:
        """Return how many open episodes had a call within the last ``within_s`` seconds."""
        return sum(self.silence_s(episode) < within_s for episode in self.registry.values())

    async def stop(self) -> None:
        """Refuse new episodes and cancel the work in the background. The next start marks open episodes as lost."""
        self.stopping = True
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    # Steps

    async def step(self, caller: Caller, episode_id: str, request: StepRequest, encoding: Encoding) -> bytes:
        """Take a step and return the reply's body. The same seq with the same action gets the stored reply.

        Raises:
            UnavailableError, SimulatorsBusyError, SimulatorStartError: The step was not taken; send it again.
            GoneError: The infrastructure failed and the episode is lost.
            NotFoundError, ForbiddenError, ConflictError: The call breaks a rule of :mod:`open_episode`.
        """
        asked = request.action
        action = rounded(asked.steer, asked.throttle, asked.brake)
        episode = self.registry.get(episode_id)
        if episode is None:
            return await self._stored_step(caller, episode_id, request.seq, action, encoding)
        episode.check_holder(caller.holder)  # before the lock, which a stranger must not take
        bind_contextvars(episode=episode_id, evaluation=episode.evaluation)
        async with episode.lock:
            episode.heard = self.clock()
            if episode.closed:
                return await self._stored_step(caller, episode_id, request.seq, action, encoding)
            if episode.check_step(request.seq):
                if not episode.counts:
                    # Noted before the step. False if the evaluation was closed before that.
                    episode.counts = await self._store.drive_evaluation(str(episode.evaluation))
                if not episode.counts:
                    return await self._stored_step(caller, episode_id, request.seq, action, encoding)
                episode.check_origin(action)
                await self._take(episode, action, encoding)
            else:
                check_same(episode_id, request.seq, action, episode.last_action)
            if episode.end is not None:
                await self._settle(episode)
            episode.heard = self.clock()
            return episode.last.render(encoding)

    def begin_step(
        self, holder: str, episode_id: str, seq: int, action: Action, encoding: Encoding, done: Done
    ) -> bool:
        """Begin the next step without a task, if only its simulator has to be waited for.

        Returns:
            Whether the step was begun. If not, nothing has happened; :meth:`step` says why.
        """
        episode = self.registry.get(episode_id)
        if episode is None or episode.holder != holder or not episode.counts:
            return False
        simulator = episode.simulator
        if seq != episode.seq + 1 or episode.end is not None or simulator is None or simulator.dead:
            return False
        if episode.differs(action):
            return False
        if not episode.locked_now():
            return False
        episode.heard = self.clock()
        began = time.perf_counter()
        under_way = simulator.step(action, encoding)
        under_way.add_done_callback(partial(self._stepped, episode, action, encoding, began, done))
        return True

    def _stepped(
        self,
        episode: OpenEpisode,
        action: Action,
        encoding: Encoding,
        began: float,
        done: Done,
        under_way: "asyncio.Future[StepResult]",
    ) -> None:
        seconds = time.perf_counter() - began
        if under_way.cancelled() or under_way.exception() is not None:
            self._spawn(self._finish(episode, action, encoding, done, None))
            return
        self._note(episode, action, under_way.result(), encoding)
        if episode.end is not None:
            self._spawn(self._finish(episode, action, encoding, done, seconds))
            return
        episode.heard = self.clock()
        episode.lock.release()
        done(episode.last, seconds)

    async def _finish(
        self, episode: OpenEpisode, action: Action, encoding: Encoding, done: Done, taken_s: float | None
    ) -> None:
        """Do the rest of a step that has to wait for storage or another simulator; release the lock."""
        logs.begin_request()
        bind_contextvars(episode=episode.id, evaluation=episode.evaluation)
        outcome: Reply | Exception
        try:
            if taken_s is None:
                await self._take(episode, action, encoding)
            else:
                await self._driver.detach(episode)
            if episode.end is not None:
                await self._settle(episode)
            episode.heard = self.clock()
            outcome = episode.last
        except Exception as error:
            outcome = error
        finally:
            episode.lock.release()
        done(outcome, taken_s)

    async def _take(self, episode: OpenEpisode, action: Action, encoding: Encoding) -> None:
        try:
            result = await self._driver.step(episode, action, encoding)
        except ReplayFailedError as error:
            raise await self._invalidate(episode, error) from error
        self._note(episode, action, result, encoding)
        if result.final is not None:
            await self._driver.detach(episode)

    def _note(self, episode: OpenEpisode, action: Action, result: StepResult, encoding: Encoding) -> None:
        practice = episode.evaluation is None
        episode.actions += ACTION.pack(*action)
        episode.last = step_reply(
            len(episode.actions) // ACTION.size,
            result.observation,
            encoding,
            episode.sight,
            terminated=result.terminated,
            truncated=result.truncated,
            reward=result.reward if practice else None,
            verdict=result.final.outcome.verdict if practice and result.final is not None else None,
        )
        episode.end = result.final

    async def _stored_step(
        self, caller: Caller, episode_id: str, seq: int, action: Action, encoding: Encoding
    ) -> bytes:
        """Answer a step of an episode that is no longer open: repeat the last reply, or refuse."""
        row = await self._row(caller, episode_id)
        if row.state != EpisodeState.FINISHED:
            raise await self._lost(row)
        if seq == row.steps and row.last_action is not None and row.last_reply is not None:
            steer, throttle, brake = ACTION.unpack(row.last_action)
            check_same(episode_id, seq, action, (steer, throttle, brake))
            return _stored_reply(caller.sight, zlib.decompress(row.last_reply)).render(encoding)
        raise episode_finished(episode_id)

    # What an episode shows

    async def view(self, caller: Caller, episode_id: str) -> bytes | None:
        """Return a picture of an open practice episode's moment, as a pixmap; None if no such episode is open."""
        episode = self.registry.get(episode_id)
        if episode is None:
            return None
        episode.check_holder(caller.holder)
        check_view(episode_id, episode.evaluation)
        async with episode.lock:
            episode.heard = self.clock()
            if episode.closed or episode.end is not None:
                return None
            try:
                return await self._driver.view(episode)
            except ReplayFailedError as error:
                raise await self._invalidate(episode, error) from error

    async def look(self, caller: Caller, episode_id: str) -> EpisodeRow:
        """Return an episode's row. If it is open, wait for its step in progress and renew its lease."""
        episode = self.registry.get(episode_id)
        if episode is not None and episode.holder == caller.holder:
            episode.heard = self.clock()
            # An agent that comes back after a crash has to see the result.
            async with episode.lock:
                pass
        return await self._stored(episode_id)

    def last_reply(self, episode_id: str, encoding: Encoding) -> tuple[int, bytes] | None:
        """Return the number and body of an open episode's last reply, or None."""
        episode = self.registry.get(episode_id)
        return None if episode is None else (episode.seq, episode.last.render(encoding))

    async def _row(self, caller: Caller, episode_id: str) -> EpisodeRow:
        row = await self._stored(episode_id)
        caller.check_episode(row)
        return row

    async def _stored(self, episode_id: str) -> EpisodeRow:
        async with self._looking_up:
            row = await self._store.episode(episode_id)
        if row is None:
            raise unknown_episode(episode_id)
        return row

    async def _lost(self, row: EpisodeRow) -> GoneError | ConflictError:
        if row.evaluation_id is not None:
            evaluation = await self._store.evaluation(row.evaluation_id)
            if evaluation is not None and evaluation.state == EvaluationState.CANCELLED:
                return cancelled(evaluation)
        why = "its simulators failed" if row.verdict == Verdict.INVALID else "the service was restarted"
        return GoneError(f"episode {row.id} is lost: {why}; it does not count, so ask for the next trial")

    # Ends

    async def abort(self, caller: Caller, episode_id: str) -> None:
        """End an episode as ``aborted``. Safe to call more than once.

        Raises:
            ConflictError: The episode has another verdict.
            UnavailableError: Its simulator was given to another agent, and other calls come first.
        """
        episode = self.registry.get(episode_id)
        if episode is not None:
            episode.check_holder(caller.holder)
            episode.heard = self.clock()
            async with episode.lock:
                await self._abort(episode)
        row = await self._row(caller, episode_id)
        if row.state != EpisodeState.FINISHED:
            raise await self._lost(row)
        if row.verdict != Verdict.ABORTED:
            raise episode_finished(episode_id)

    async def abort_evaluation(self, evaluation_id: str) -> None:
        """End an evaluation's open episodes as ``aborted``, without waiting for simulators."""
        for episode in self.registry.of(evaluation_id):
            async with episode.lock:
                await self._abort(episode, wait=False)

    async def drop(self, evaluations: Collection[str], holders: Collection[str] = ()) -> None:
        """Close the open episodes of evaluations that are over, and of ``holders``: deleted agents and submissions."""
        for episode in list(self.registry.values()):
            if episode.evaluation in evaluations or episode.holder in holders:
                async with episode.lock:
                    if not episode.closed:
                        self._telemetry.voided.labels("cancelled").inc()
                    await self._close(episode)

    async def lose(self, submission: str, patience_s: float = PATIENCE_S) -> None:
        """Give up the open episodes of a runner that is gone, and whose token has ended. Their trials run again.

        Resets in progress would open episodes that nobody drives, so it waits for them ``patience_s`` seconds. Leases
        end what is opened later.
        """
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(patience_s):
                while True:
                    for episode in list(self.registry.values()):
                        if episode.holder == submission:
                            async with episode.lock:
                                await self._lose(episode)
                    if not self.registry.count(submission):
                        return
                    await asyncio.sleep(_LOOK_S)

    async def _lose(self, episode: OpenEpisode) -> None:
        if episode.closed:
            return
        if episode.end is not None:
            await self._settle(episode)  # the last step was taken, but its end was not stored yet
            return
        await self._void(episode, "runner-ended")

    async def _void(self, episode: OpenEpisode, reason: Voided, verdict: Verdict | None = None) -> None:
        """Give an episode up. It does not count, and its trial runs again."""
        self._telemetry.voided.labels(reason).inc()
        await self._store.lose_episode(episode.id, verdict)
        await self._close(episode)
        schedule = self._evaluations.known(episode.evaluation)
        if schedule is not None:
            schedule.put_back(episode.trial)

    async def _abort(self, episode: OpenEpisode, *, wait: bool = True) -> None:
        if episode.closed:
            return
        if episode.end is None:
            simulated = wait or episode.simulator is not None
            episode.end = await self._driver.abort(episode) if simulated else aborted_end(episode)
            await self._driver.detach(episode)
        await self._settle(episode)

    async def _invalidate(self, episode: OpenEpisode, error: ReplayFailedError) -> GoneError:
        """Give an episode up after a failure of the infrastructure, and return the error."""
        self._log.error("episode invalid", episode=episode.id, trial=episode.trial.id)
        await self._void(episode, "simulators-failed", Verdict.INVALID)
        return GoneError(f"episode {episode.id}: {error}; it is invalid and its trial runs again, so ask for the next")

    async def _settle(self, episode: OpenEpisode) -> None:
        """Store an episode's end and close it. Raises SQLAlchemy's errors; safe to call again."""
        end = episode.end
        assert end is not None
        values = {
            "verdict": end.outcome.verdict.value,
            "outcome": end.outcome.model_dump_json(),
            "steps": end.steps,
            "actions_sha256": end.actions_sha256 or None,
            "trajectory_sha256": end.trajectory_sha256 or None,
            "last_action": bytes(episode.actions[-ACTION.size :]) or None,
            "last_reply": zlib.compress(episode.last.render(Encoding.JSON)) if episode.seq else None,
        }
        stored = await self._store.finish_episode(episode.id, values, end.trajectory, end.trajectory_sha256)
        await self._close(episode)
        if episode.evaluation is None:
            if stored:
                self._telemetry.ended.labels("false", end.outcome.verdict.value).inc()
            return
        # Scored verdicts are hidden, also from those who read the metrics, until the whole evaluation is finished.
        if not stored:
            raise finished(episode.evaluation)
        self._log.info("episode finished", episode=episode.id, evaluation=episode.evaluation, steps=end.steps)
        schedule = self._evaluations.known(episode.evaluation)
        if schedule is not None:
            schedule.finish(episode.trial)
            await self._evaluations.finish_if_done(episode.evaluation)

    async def _close(self, episode: OpenEpisode) -> None:
        if episode.closed:
            return
        episode.closed = True
        del self.registry[episode.id]
        self.registry.give_back(episode.payer, practice=episode.evaluation is None)
        await self._driver.detach(episode)

    # Leases

    async def watch_leases(self) -> None:
        """Check every lease at regular intervals until cancelled."""
        while True:
            await asyncio.sleep(min(LEASES_EVERY_S, self._release_s / 4, self.abort_s / 4))
            for episode in self.registry.values():
                silence_s = self.silence_s(episode)
                if silence_s >= (self._release_s if episode.placed else self.abort_s) or (
                    episode.end is not None and not episode.lock.locked()
                ):
                    self._spawn(self._look_after(episode))

    async def _make_room(self, waiting: OpenEpisode, count: int) -> float | None:
        """Take up to ``count`` idle simulators for an episode that waits, from those who hold more than its agent.

        Those who hold most come first, by address, then owner, then agent. From its own address it takes one only after
        twice the time, so that no group turns its simulators over without end. An agent whose next step waits can take
        one from itself. An evaluation's episode loses none between its first step and the end of its lease. Return the
        seconds until one more can be taken, None if there is none.
        """
        if self.clock() - waiting.heard >= self.abort_s:
            return None  # its lease ends it, and nobody waits
        mine = self._driver.holds(waiting)
        whose = waiting.holder if waiting.id in self.registry else None

        def left_s(episode: OpenEpisode) -> float | None:
            theirs = self._driver.holds(episode)
            free = episode.placed and (episode.evaluation is None or not episode.actions)
            if not free or not (episode.holder == whose or theirs > mine):
                return None
            idle_s = IDLE_S if theirs[0] > mine[0] else 2 * IDLE_S
            return min(idle_s, self._release_s) - self.silence_s(episode)

        for _ in range(count):
            found = [(left, one) for one in self.registry.values() if (left := left_s(one)) is not None]
            over = [one for left, one in found if left <= 0]
            if not over:
                return min((left for left, _ in found), default=None)
            taken = max(over, key=lambda one: (self._driver.holds(one), self.silence_s(one)))
            if taken.locked_now():
                try:
                    await self._driver.detach(taken)
                finally:
                    taken.lock.release()
        return None

    async def _look_after(self, episode: OpenEpisode) -> None:
        """Release a silent agent's simulator, later abort its episode; store an end that the database refused."""
        # If other calls come first, the episode waits in the queue until the next check; its agent may still come back.
        with contextlib.suppress(UnavailableError):
            async with episode.lock:
                silence_s = self.clock() - episode.heard
                if episode.closed:
                    return
                if episode.end is not None:
                    with contextlib.suppress(SQLAlchemyError):
                        await self._settle(episode)
                elif silence_s >= self.abort_s:
                    await self._abort(episode)
                    self._telemetry.expired.inc()
                elif silence_s >= self._release_s:
                    await self._driver.detach(episode)

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._worked)

    def _worked(self, task: "asyncio.Task[None]") -> None:
        self._tasks.discard(task)
        if not task.cancelled() and task.exception() is not None:
            self._log.error("background work failed", reason=repr(task.exception()))


def _stored_reply(sight: Sight, body: bytes) -> Reply:
    """Return the reply to a finished episode's last step, from its stored JSON."""
    message = orjson.loads(body)
    return step_reply(
        message["seq"],
        orjson.dumps(message["observation"]),
        Encoding.JSON,
        sight,
        terminated=message["terminated"],
        truncated=message["truncated"],
        reward=message.get("reward"),
        verdict=Verdict(message["verdict"]) if "verdict" in message else None,
    )
