"""Watches for silent agents: first their simulators are released, later their episodes are aborted."""

import asyncio
import contextlib

import structlog

from wrongturn_service.episodes.driver import EpisodeDriver
from wrongturn_service.episodes.endings import Endings
from wrongturn_service.episodes.lease import Standing, Terms
from wrongturn_service.episodes.loans import Loans
from wrongturn_service.episodes.open_episode import OpenEpisode
from wrongturn_service.episodes.registry import Registry
from wrongturn_service.errors import UnavailableError


class Watch:
    """Checks every lease at regular intervals."""

    def __init__(self, registry: Registry, driver: EpisodeDriver, endings: Endings, loans: Loans, terms: Terms) -> None:
        self._registry = registry
        self._driver = driver
        self._endings = endings
        self._loans = loans
        self._terms = terms
        self._background: set[asyncio.Task[None]] = set()
        self._log = structlog.get_logger("episodes")

    async def run(self) -> None:
        """Check the leases until cancelled."""
        while True:
            await asyncio.sleep(self._terms.period_s)
            await self._loans.look()
            for episode in self._registry:
                if episode.lock.locked():
                    continue
                standing = episode.lease.standing
                if episode.end is not None:
                    self._spawn(self._endings.settle_again(episode))
                elif standing is Standing.EXPIRED:
                    self._spawn(self._expire(episode))
                elif standing is Standing.RELEASE and episode.placed:
                    self._spawn(self._release(episode))

    async def stop(self) -> None:
        """Cancel the work in the background."""
        for task in self._background:
            task.cancel()
        await asyncio.gather(*self._background, return_exceptions=True)

    async def _release(self, episode: OpenEpisode) -> None:
        async with episode.lock:
            if episode.lease.standing is not Standing.HELD:
                await self._driver.detach(episode)

    async def _expire(self, episode: OpenEpisode) -> None:
        # If other calls come first, the episode waits in the queue until the next check; its agent may still come back.
        with contextlib.suppress(UnavailableError):
            await self._endings.expire(episode)

    def _spawn(self, work: "asyncio._CoroutineLike[None]") -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._background.add(task)
        task.add_done_callback(self._done)

    def _done(self, task: "asyncio.Task[None]") -> None:
        self._background.discard(task)
        if not task.cancelled() and task.exception() is not None:
            self._log.error("background work failed", reason=repr(task.exception()))
