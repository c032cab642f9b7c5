"""Lends clients' connections to the simulators that drive their episodes, and takes in what was done meanwhile."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Protocol

from wrongturn_service.encoding import Encoding
from wrongturn_service.episodes.open_episode import OpenEpisode
from wrongturn_service.episodes.registry import Registry
from wrongturn_service.episodes.steps import Done, Steps, step_reply_of
from wrongturn_service.simulators.interface import LastStep, LoanRequest, LoanResult, StepResult

if TYPE_CHECKING:
    import asyncio


class Lendable(Protocol):
    """A connection that can be lent."""

    def lend(self, recall: Callable[[], None]) -> int | None:
        """Leave it alone from now on.

        Args:
            recall: to be called when something has to be done with it.

        Returns:
            Its file descriptor; None where it cannot be lent, and nothing has happened.
        """

    def answer(self, last: LastStep) -> Done:
        """Who is told the reply to the step that ended the episode."""

    def returned(self, came: LoanResult) -> None:
        """Use it again.

        Args:
            came: what is left to be done with it.
        """


class Loans:
    """Lends while an agent does nothing but take steps in one episode."""

    def __init__(self, registry: Registry, steps: Steps) -> None:
        self._registry = registry
        self._steps = steps
        self._lent: set[OpenEpisode] = set()

    def __len__(self) -> int:
        """How many there are."""
        return len(self._lent)

    async def recall(self) -> None:
        """Have all of them back."""
        lent = list(self._lent)
        for episode in lent:
            if episode.lock.recall is not None:
                episode.lock.recall()
        for episode in lent:
            async with episode.lock:
                pass

    def begin(self, agent: str, episode_id: str, connection: Lendable) -> bool:
        """Lend a connection; the episode's lock is held until it is back.

        Args:
            agent: who asks.
            episode_id: whose steps come next.
            connection: over which.

        Returns:
            Whether it is lent; if not, nothing has happened.
        """
        episode = self._registry.get(episode_id)
        if (
            episode is None
            or episode.agent != agent
            or episode.end is not None
            or episode.last.encoding is not Encoding.RAW
        ):
            return False
        simulator = episode.simulator
        if simulator is None or not simulator.lends or not episode.lock.taken_now():
            return False
        handle = connection.lend(simulator.recall)
        if handle is None:
            episode.lock.release()
            return False
        episode.lock.recall = simulator.recall
        self._lent.add(episode)
        loan = simulator.lend(LoanRequest(handle, episode.id, episode.track, episode.seq, episode.practice))
        loan.add_done_callback(partial(self._back, episode, connection))
        return True

    def _back(self, episode: OpenEpisode, connection: Lendable, loan: "asyncio.Future[LoanResult]") -> None:
        came = loan.result()
        episode.lock.recall = None
        self._lent.discard(episode)
        episode.lease.renew(came.silence_s)
        if came.observation is not None:
            episode.actions += came.actions
            shown = StepResult(came.observation, came.reward, terminated=False, truncated=False, final=None)
            episode.last = step_reply_of(episode, shown, Encoding.RAW)
        if came.last is None:
            episode.lock.release()
        else:
            last = came.last
            self._steps.take_in(episode, last.action, Encoding.RAW, last.frame, last.seconds, connection.answer(last))
        connection.returned(came)
