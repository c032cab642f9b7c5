"""How episodes begin: the next trial of an evaluation, or practice."""

import time
from collections.abc import Callable

from structlog.contextvars import bind_contextvars

from wrongturn_protocol import EpisodeState, ProblemType, Track, Trial
from wrongturn_service.episodes.driver import Driver, ReplayFailedError
from wrongturn_service.episodes.endings import Endings
from wrongturn_service.episodes.lease import Lease, Terms
from wrongturn_service.episodes.open_episode import OpenEpisode
from wrongturn_service.episodes.registry import Registry
from wrongturn_service.episodes.running import RunningEvaluations, cancelled, finished
from wrongturn_service.errors import ConflictError, UnavailableError
from wrongturn_service.pool.screen import Shown
from wrongturn_service.storage.models import EpisodeRow, EvaluationRow, IdempotencyRow
from wrongturn_service.storage.store import Store
from wrongturn_service.tokens import new_id
from wrongturn_service.wire import Reply, Wire, reset_reply

Remember = Callable[[bytes], IdempotencyRow] | None
"""Makes of a reply what is stored for its idempotency key; None where the request had no key."""


class Openings:
    """Opens episodes."""

    def __init__(
        self,
        store: Store,
        driver: Driver,
        evaluations: RunningEvaluations,
        registry: Registry,
        endings: Endings,
        terms: Terms,
    ) -> None:
        self._store = store
        self._driver = driver
        self._evaluations = evaluations
        self._registry = registry
        self._endings = endings
        self._terms = terms

    async def next(
        self, evaluation: EvaluationRow, track: Track, wire: Wire, remember: Remember, key: str | None
    ) -> bytes:
        """See :meth:`EpisodeManager.open_next`."""
        schedule = await self._evaluations.schedule(evaluation)
        if schedule.finished:
            await self._evaluations.finish_if_done(evaluation.id)
            raise finished(evaluation.id)
        limit = self._registry.limits.evaluation
        trial = schedule.take() if schedule.open < limit else None
        if trial is None:
            raise ConflictError(
                ProblemType.NO_TRIAL_AVAILABLE,
                f"{schedule.open} episodes of evaluation {evaluation.id} are open, at most {limit} may be, "
                "and a trial and its twin never are at the same time; finish one, or ask again later",
                headers={"Retry-After": "1"},
            )
        try:
            call = f"{evaluation.id} {key}"
            body = await self._begin(evaluation.agent_id, evaluation.id, trial, track, wire, remember, call)
        except BaseException:
            schedule.put_back(trial)
            raise
        if self._evaluations.known(evaluation.id) is not schedule:
            # It was cancelled meanwhile, before this episode was there to be ended with it.
            await self._endings.cancel(evaluation.id)
            raise cancelled(evaluation.id)
        return body

    async def practice(
        self, agent: str, trial: Trial, track: Track, wire: Wire, remember: Remember, key: str | None
    ) -> bytes:
        """See :meth:`EpisodeManager.open_practice`."""
        return await self._begin(agent, None, trial, track, wire, remember, f"practice {key}")

    async def _begin(
        self,
        agent: str,
        evaluation: str | None,
        trial: Trial,
        track: Track,
        wire: Wire,
        remember: Remember,
        call: str,
    ) -> bytes:
        practice = evaluation is None
        self._registry.reserve(agent, practice=practice)
        try:
            return await self._open(agent, evaluation, trial, track, wire, remember, call)
        except BaseException:
            self._registry.give_back(agent, practice=practice)
            raise

    async def _open(
        self,
        agent: str,
        evaluation: str | None,
        trial: Trial,
        track: Track,
        wire: Wire,
        remember: Remember,
        call: str,
    ) -> bytes:
        practice = evaluation is None
        episode_id = new_id("ep")
        bind_contextvars(episode=episode_id, evaluation=evaluation)
        lease = Lease(self._terms)

        def reply(observation: bytes | Shown) -> Reply:
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
                frame = await self._driver.begin(episode, wire, call)
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
            self._registry.add(episode)
        return body
