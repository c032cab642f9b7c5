"""Lends clients' connections to the simulators that drive their episodes, and takes over what they did there."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, Protocol

from wrongturn_service.encoding import Encoding
from wrongturn_service.episodes.open_episode import OpenEpisode
from wrongturn_service.episodes.refusals import is_next_step
from wrongturn_service.episodes.registry import Registry
from wrongturn_service.episodes.steps import Done, Steps, step_reply_of
from wrongturn_service.simulators.action_log import Seconds
from wrongturn_service.simulators.interface import LastStep, Loan, LoanEnd, Simulator, StepResult

_PART: Final = 256
"""Steps that are counted before other calls go on."""


class LendableConnection(Protocol):
    """A client's connection that can be lent."""

    def lend(self, recall: Callable[[], None]) -> int | None:
        """Stop using the connection.

        Args:
            recall: ends the loan soon.

        Returns:
            Its file descriptor; None, without any effect, if it cannot be lent now.
        """

    def count_steps(self, seconds: Sequence[Seconds]) -> None:
        """Count steps that the simulator answered."""

    def answer(self, last: LastStep) -> Done:
        """Return what sends the reply to the step that ended the episode."""

    def returned(self, end: LoanEnd) -> None:
        """Use the connection again, or close it if the simulator died."""


@dataclass(slots=True)
class _OpenLoan:
    """A loan, and how many of its steps are counted."""

    episode: OpenEpisode
    simulator: Simulator
    connection: LendableConnection
    counted: int = 0

    def count(self, steps: Sequence[Seconds]) -> bool:
        """Count further steps; the agent that took them is not silent. Return whether there are any."""
        if steps:
            self.counted += len(steps)
            self.connection.count_steps(steps)
            self.episode.lease.renew()
        return bool(steps)


class Loans:
    """Lends while an agent does nothing on its connection but take steps in one episode."""

    def __init__(self, registry: Registry, steps: Steps) -> None:
        self._registry = registry
        self._steps = steps
        self._loans: dict[OpenEpisode, _OpenLoan] = {}

    def __len__(self) -> int:
        """Return the number of loans."""
        return len(self._loans)

    async def recall(self) -> None:
        """End all loans."""
        for loan in self._loans.values():
            loan.simulator.recall()
        for episode in list(self._loans):
            async with episode.lock:
                pass

    async def look(self) -> None:
        """Count the steps since the last look. Loans without any end: the client is silent, or the simulator hangs."""
        for episode, loan in list(self._loans.items()):
            before = loan.counted
            while self._loans.get(episode) is loan:
                if not loan.count(loan.simulator.answered(loan.counted, _PART)):
                    if loan.counted == before:
                        loan.simulator.recall()
                    break
                # There may be thousands. Other calls go on between the parts, and the loan may end.
                await asyncio.sleep(0)

    def begin(self, holder: str, episode_id: str, connection: LendableConnection) -> bool:
        """Lend a connection. The episode's lock is held until it is back.

        Args:
            holder: who asks, the agent or the submission whose runner does.
            episode_id: the episode of the next steps.
            connection: where they come.

        Returns:
            Whether it is lent; otherwise nothing has happened.
        """
        episode = self._registry.get(episode_id)
        if episode is None or not episode.counts or not is_next_step(episode, holder, episode.seq + 1):
            return False
        simulator = episode.simulator
        if simulator is None or not simulator.lends or episode.last.encoding is not Encoding.RAW:
            return False
        if not episode.lock.taken_now():
            return False
        handle = connection.lend(simulator.recall)
        if handle is None:
            episode.lock.release()
            return False
        episode.lock.recall = simulator.recall
        self._loans[episode] = loan = _OpenLoan(episode, simulator, connection)
        over = simulator.lend(Loan(handle, episode.id, episode.track, episode.seq, episode.practice))
        over.add_done_callback(partial(self._end, loan))
        return True

    def _end(self, loan: _OpenLoan, over: "asyncio.Future[LoanEnd]") -> None:
        end, episode = over.result(), loan.episode
        episode.lock.recall = None
        del self._loans[episode]
        loan.count(end.steps.seconds[loan.counted :])
        if end.observation is not None:
            episode.actions += end.steps.actions
            result = StepResult(end.observation, end.steps.reward, terminated=False, truncated=False, final=None)
            episode.last = step_reply_of(episode, result, Encoding.RAW)
        if end.last is None:
            episode.lock.release()
        else:
            last, reply = end.last, loan.connection.answer(end.last)
            self._steps.take_in(episode, last.action, Encoding.RAW, last.result, last.seconds, reply)
        loan.connection.returned(end)
