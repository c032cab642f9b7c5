"""What is kept in memory of an open episode: enough to repeat it in another simulator."""

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


def as_float32(action: Action) -> Triple:
    """The action as it is used: what differs by less than a float32 is the same action."""
    return rounded(action.steer, action.throttle, action.brake)


class EpisodeLock(asyncio.Lock):
    """Whoever wants it has what is lent to the episode's simulator called back."""

    def __init__(self) -> None:
        super().__init__()
        self.recall: Callable[[], None] | None = None
        """Calls it back; None while nothing is lent. Who lends holds the lock."""

    @override
    async def acquire(self) -> Literal[True]:
        if self.recall is not None:
            self.recall()
        return await super().acquire()

    def taken_now(self) -> bool:
        """Take it if that is possible without waiting; whether it is."""
        if self.locked():
            return False
        attempt = self.acquire()
        try:
            attempt.send(None)
        except StopIteration:
            return True
        attempt.close()  # somebody waits who was told that it is free, and comes first
        return False


@dataclass(eq=False)
class OpenEpisode:
    """One episode that an agent is driving.

    Attributes:
        id: opaque.
        agent: the owner's id.
        evaluation: its evaluation's id; None in practice.
        trial: what is driven.
        track: what is observed.
        last: the last reply.
        lease: how long the agent has been silent.
        actions: all so far, little-endian float32 [n, 3].
        simulator: where it runs; None while it was given to others, or died.
        placed: whether a simulator's place is its own, with or without the simulator.
        end: what came of it, once it is over.
        closed: whether it is settled, stored or given up: look it up in the database from then on.
    """

    id: str
    agent: str
    evaluation: str | None
    trial: Trial
    track: Track
    last: Reply
    lease: Lease
    actions: bytearray = field(default_factory=bytearray)
    simulator: Simulator | None = None
    placed: bool = False
    end: EpisodeEnd | None = None
    closed: bool = False
    lock: EpisodeLock = field(default_factory=EpisodeLock)

    @property
    def seq(self) -> int:
        """Of the last reply."""
        return self.last.seq

    @property
    def practice(self) -> bool:
        """Whether it is never scored."""
        return self.evaluation is None

    @property
    def last_action(self) -> Triple | None:
        """The last step's action; None before the first."""
        if not self.actions:
            return None
        steer, throttle, brake = ACTION.unpack_from(self.actions, len(self.actions) - ACTION.size)
        return steer, throttle, brake
