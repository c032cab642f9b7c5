"""Steps of open episodes. A plain step needs no task; everything else does."""

import asyncio
import time
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

import orjson
from structlog.contextvars import bind_contextvars

from wrongturn_protocol import Track, Verdict
from wrongturn_service import logs
from wrongturn_service.encoding import Encoding, Reply, step_reply
from wrongturn_service.episodes.driver import EpisodeDriver, ReplayFailedError
from wrongturn_service.episodes.endings import Endings
from wrongturn_service.episodes.open_episode import OpenEpisode
from wrongturn_service.episodes.refusals import is_next_step
from wrongturn_service.episodes.registry import Registry
from wrongturn_service.errors import GoneError
from wrongturn_service.simulators.action_log import ACTION, Action
from wrongturn_service.simulators.interface import StepResult
from wrongturn_service.storage.models import EpisodeRow


def step_reply_of(episode: OpenEpisode, result: StepResult, encoding: Encoding) -> Reply:
    """Return the reply to an open episode's last action."""
    return step_reply(
        len(episode.actions) // ACTION.size,
        result.observation,
        encoding,
        episode.track,
        terminated=result.terminated,
        truncated=result.truncated,
        reward=result.reward if episode.practice else None,
        verdict=result.final.outcome.verdict if episode.practice and result.final is not None else None,
    )


def stored_reply(row: EpisodeRow, body: bytes) -> Reply:
    """Return the reply to a finished episode's last step.

    Args:
        row: The episode's row.
        body: The stored reply, JSON.
    """
    message = orjson.loads(body)
    return step_reply(
        message["seq"],
        orjson.dumps(message["observation"]),
        Encoding.JSON,
        Track(row.track),
        terminated=message["terminated"],
        truncated=message["truncated"],
        reward=message.get("reward"),
        verdict=Verdict(message["verdict"]) if "verdict" in message else None,
    )


Done = Callable[[Reply | Exception, float | None], None]
"""Called with a step's reply or error, and with the simulator's seconds unless telemetry has them already."""


class Steps:
    """Takes steps. Callers hold the episode's lock unless a method says otherwise."""

    def __init__(self, registry: Registry, driver: EpisodeDriver, endings: Endings) -> None:
        self._registry = registry
        self._driver = driver
        self._endings = endings
        self._tasks: set[asyncio.Task[None]] = set()

    async def take(self, episode: OpenEpisode, action: Action, encoding: Encoding) -> None:
        """Take the next step.

        Raises:
            UnavailableError, SimulatorsBusyError, SimulatorStartError: The step was not taken; send it again.
            GoneError: The infrastructure failed and the episode is lost.
        """
        try:
            result = await self._driver.step(episode, action, encoding)
        except ReplayFailedError as error:
            raise await self._invalid(episode, error) from error
        self._note(episode, action, result, encoding)
        if result.final is not None:
            await self._driver.detach(episode)

    async def view(self, episode: OpenEpisode) -> bytes:
        """Return a picture of an episode's moment, as a pixmap.

        Raises:
            UnavailableError, SimulatorsBusyError, SimulatorStartError: Send the call again.
            GoneError: The infrastructure failed and the episode is lost.
        """
        try:
            return await self._driver.view(episode)
        except ReplayFailedError as error:
            raise await self._invalid(episode, error) from error

    async def _invalid(self, episode: OpenEpisode, error: ReplayFailedError) -> GoneError:
        await self._endings.invalidate(episode)
        return GoneError(f"episode {episode.id}: {error}; it is invalid and its trial runs again, so ask for the next")

    def begin(self, holder: str, episode_id: str, seq: int, action: Action, encoding: Encoding, done: Done) -> bool:
        """Begin the next step if only its simulator has to be waited for. Takes the lock.

        Returns:
            Whether the step was begun. If not, nothing has happened; the full path says why.
        """
        episode = self._registry.get(episode_id)
        if episode is None or not episode.counts or not is_next_step(episode, holder, seq):
            return False
        simulator = episode.simulator
        if simulator is None or simulator.dead or not episode.lock.taken_now():
            return False
        episode.lease.renew()
        began = time.perf_counter()
        under_way = simulator.begin_step(action, encoding)
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
        result = None if under_way.cancelled() or under_way.exception() is not None else under_way.result()
        if result is None:
            self._spawn(self._finish(episode, action, encoding, done, None))
        else:
            self.take_in(episode, action, encoding, result, seconds, done)

    def take_in(
        self, episode: OpenEpisode, action: Action, encoding: Encoding, result: StepResult, seconds: float, done: Done
    ) -> None:
        """Note a step that was taken, store the episode if it is over, and release its lock.

        Args:
            episode: The episode.
            action: The action.
            encoding: Encoding of the observation.
            result: The step's result.
            seconds: Seconds that the simulation took.
            done: Called with the reply.
        """
        self._note(episode, action, result, encoding)
        if result.final is None:
            episode.lease.renew()
            episode.lock.release()
            done(episode.last, seconds)
        else:
            self._spawn(self._finish(episode, action, encoding, done, seconds))

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _finish(
        self,
        episode: OpenEpisode,
        action: Action,
        encoding: Encoding,
        done: Done,
        taken_s: float | None,
    ) -> None:
        """Do the rest of a step that has to wait for storage or another simulator."""
        logs.begin_request()
        bind_contextvars(episode=episode.id, evaluation=episode.evaluation)
        outcome: Reply | Exception
        try:
            if taken_s is not None:
                await self._driver.detach(episode)
            else:
                await self.take(episode, action, encoding)
            if episode.end is not None:
                await self._endings.settle(episode)
            episode.lease.renew()
            outcome = episode.last
        except Exception as error:
            outcome = error
        finally:
            episode.lock.release()
        done(outcome, taken_s)

    def _note(self, episode: OpenEpisode, action: Action, result: StepResult, encoding: Encoding) -> None:
        episode.actions += ACTION.pack(*action)
        episode.last = step_reply_of(episode, result, encoding)
        episode.end = result.final
