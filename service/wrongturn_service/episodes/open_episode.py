"""An open episode in memory: enough to replay it in another simulator."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from typing_extensions import override

from wrongturn_protocol import Track, Trial
from wrongturn_protocol.episodes import Action
from wrongturn_service.encoding import Reply
from wrongturn_service.episodes.lease import Lease
from wrongturn_service.simulators.action_log import ACTION, rounded
from wrongturn_service.simulators.action_log import Action as Triple
from wrongturn_service.simulators.interface import EpisodeEnd, Simulator


@dataclass(frozen=True, slots=True)
class Payer:
    """Whose limits an open episode counts to.

    Attributes:
        holder: Id of who drives it: the agent, or the submission whose runner does.
        owner: Id of the agent's owner.
        address: The address that has begun it. None for a runner, whose address is the service's own.
    """

    holder: str
    owner: str
    address: str | None


def as_float32(action: Action) -> Triple:
    """Return an action rounded to float32. Actions that round to the same values are the same."""
    return rounded(action.steer, action.throttle, action.brake)


class EpisodeLock(asyncio.Lock):
    """Lock of an episode. To acquire it calls back a connection that is lent to the episode's simulator."""

    def __init__(self) -> None:
        super().__init__()
        self.recall: Callable[[], None] | None = None
        """Calls the connection back. None while none is lent; the lender holds the lock."""

    @override
    async def acquire(self) -> Literal[True]:
        if self.recall is not None:
            self.recall()
        return await super().acquire()

    def taken_now(self) -> bool:
        """Acquire the lock without waiting and return whether that worked."""
        if self.locked():
            return False
        attempt = self.acquire()
        try:
            attempt.send(None)
        except StopIteration:
            return True
        attempt.close()  # another task was just woken to take it
        return False


@dataclass(eq=False)
class OpenEpisode:
    """An episode that an agent drives.

    Attributes:
        id: Opaque id.
        payer: Who drives it, and whose limits it counts to.
        evaluation: Id of the evaluation, None in practice.
        trial: The trial.
        track: What the agent observes.
        last: The last reply.
        lease: How long the agent has been silent.
        actions: All actions so far, little-endian float32 [n, 3].
        simulator: The simulator, None while it is released or dead.
        counts: Whether the evaluation is known to have had a step, so that it counts; true in practice.
        placed: Whether the episode holds a place of the queue, with or without a simulator.
        end: The end, once the episode is over.
        closed: Whether the episode is stored or given up. From then on only the database knows it.
    """

    id: str
    payer: Payer
    evaluation: str | None
    trial: Trial
    track: Track
    last: Reply
    lease: Lease
    actions: bytearray = field(default_factory=bytearray)
    simulator: Simulator | None = None
    counts: bool = False
    placed: bool = False
    end: EpisodeEnd | None = None
    closed: bool = False
    lock: EpisodeLock = field(default_factory=EpisodeLock)

    @property
    def seq(self) -> int:
        """Sequence number of the last reply."""
        return self.last.seq

    @property
    def holder(self) -> str:
        """Id of who drives it: the agent, or the submission whose runner does."""
        return self.payer.holder

    @property
    def practice(self) -> bool:
        """Whether the episode is practice, which is never scored."""
        return self.evaluation is None

    @property
    def last_action(self) -> Triple | None:
        """Action of the last step, None before the first."""
        if not self.actions:
            return None
        steer, throttle, brake = ACTION.unpack_from(self.actions, len(self.actions) - ACTION.size)
        return steer, throttle, brake
