"""How episodes begin: the next trial of an evaluation, or practice."""

import asyncio
import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

from structlog.contextvars import bind_contextvars

from wrongturn_protocol import EpisodeState, ProblemType, Track, Trial
from wrongturn_service.encoding import Encoding, Reply, reset_reply
from wrongturn_service.episodes.driver import EpisodeDriver, ReplayFailedError
from wrongturn_service.episodes.endings import Endings
from wrongturn_service.episodes.evaluations import RunningEvaluations, cancelled, finished
from wrongturn_service.episodes.lease import Lease, Terms
from wrongturn_service.episodes.open_episode import OpenEpisode
from wrongturn_service.episodes.registry import Registry
from wrongturn_service.errors import ConflictError, UnavailableError
from wrongturn_service.simulators.shared_memory import ObservationView
from wrongturn_service.storage.models import EpisodeRow, EvaluationRow, IdempotencyRow
from wrongturn_service.storage.store import Store
from wrongturn_service.tokens import new_id

PATIENCE_S: Final = 20.0
"""Seconds for which they are waited for; less than a client waits for an answer."""


class Beginnings:
    """Resets by their evaluation, from their arrival to their reply.

    An agent that was killed while it waited for a reset's reply would else come back, find nothing open and go on,
    and the episode would be begun after that for nobody.
    """

    def __init__(self) -> None:
        self._under_way: dict[str, set[asyncio.Event]] = {}

    @contextlib.contextmanager
    def one(self, evaluation_id: str) -> Iterator[None]:
        """A reset is under way for as long as the block lasts."""
        over = asyncio.Event()
        others = self._under_way.setdefault(evaluation_id, set())
        others.add(over)
        try:
            yield
        finally:
            over.set()
            others.discard(over)
            if not others:
                self._under_way.pop(evaluation_id, None)

    async def over(self, evaluation_id: str, patience_s: float = PATIENCE_S) -> None:
        """Wait until those are over that are under way now.

        Raises:
            UnavailableError: they take too long.
        """
        try:
            async with asyncio.timeout(patience_s):
                for event in list(self._under_way.get(evaluation_id, ())):
                    await event.wait()
        except TimeoutError as error:
            raise UnavailableError(
                ProblemType.SIMULATORS_BUSY,
                f"an episode of evaluation {evaluation_id} is just being begun; ask again",
                retry_after_s=1,
            ) from error


Remember = Callable[[bytes], IdempotencyRow] | None
"""Makes of a reply what is stored for its idempotency key; None where the request had no key."""


@dataclass(frozen=True, slots=True)
class _Wanted:
    """An episode that is asked for."""

    agent: str
    evaluation: str | None
    """None for practice."""
    trial: Trial
    track: Track
    encoding: Encoding
    """Of the reply."""
    remember: Remember
    call: str
    """Names the request in the line for a simulator: sent again, it keeps its place."""

    @property
    def practice(self) -> bool:
        return self.evaluation is None


class Openings:
    """Opens episodes."""

    def __init__(
        self,
        store: Store,
        driver: EpisodeDriver,
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
        self, evaluation: EvaluationRow, track: Track, encoding: Encoding, remember: Remember, key: str | None
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
            wanted = _Wanted(evaluation.agent_id, evaluation.id, trial, track, encoding, remember, call)
            body = await self._begin(wanted)
        except BaseException:
            schedule.put_back(trial)
            raise
        if self._evaluations.known(evaluation.id) is not schedule:
            # It was cancelled meanwhile, before this episode was there to be ended with it.
            await self._endings.cancel(evaluation.id)
            raise cancelled(evaluation.id)
        return body

    async def practice(
        self, agent: str, trial: Trial, track: Track, encoding: Encoding, remember: Remember, key: str | None
    ) -> bytes:
        """See :meth:`EpisodeManager.open_practice`."""
        return await self._begin(_Wanted(agent, None, trial, track, encoding, remember, f"practice {key}"))

    async def _begin(self, wanted: _Wanted) -> bytes:
        self._registry.reserve(wanted.agent, practice=wanted.practice)
        try:
            return await self._open(wanted)
        except BaseException:
            self._registry.give_back(wanted.agent, practice=wanted.practice)
            raise

    async def _open(self, wanted: _Wanted) -> bytes:
        trial, track, encoding = wanted.trial, wanted.track, wanted.encoding
        episode_id = new_id("ep")
        bind_contextvars(episode=episode_id, evaluation=wanted.evaluation)
        lease = Lease(self._terms)

        def reply(observation: bytes | ObservationView) -> Reply:
            return reset_reply(
                episode_id,
                observation,
                encoding,
                track,
                town=trial.town if wanted.practice or track is Track.PRIVILEGED else None,
                trial=trial.id if wanted.practice else None,
                lease_s=self._terms.abort_s,
            )

        episode = OpenEpisode(episode_id, wanted.agent, wanted.evaluation, trial, track, reply(b""), lease)
        async with episode.lock:
            try:
                frame = await self._driver.begin(episode, encoding, wanted.call)
            except ReplayFailedError as error:
                raise UnavailableError(ProblemType.SIMULATOR_FAILED, f"{error}; try again", retry_after_s=5) from error
            episode.last = reply(frame.observation)
            body = episode.last.render(encoding)
            row = EpisodeRow(
                id=episode_id,
                evaluation_id=wanted.evaluation,
                agent_id=wanted.agent,
                trial_id=trial.id,
                trial=trial.model_dump_json(),
                track=track.value,
                state=EpisodeState.OPEN.value,
                created=time.time(),
                steps=0,
            )
            try:
                await self._store.add_episode(row, wanted.remember(body) if wanted.remember is not None else None)
            except BaseException:
                await self._driver.detach(episode)
                raise
            lease.renew()
            self._registry.add(episode)
        return body
