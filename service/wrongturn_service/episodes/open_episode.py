"""What is kept in memory of an open episode: enough to repeat it in another simulator."""

import asyncio
import struct
from dataclasses import dataclass, field
from typing import Final

from wrongturn_protocol import Track, Trial
from wrongturn_protocol.episodes import Action
from wrongturn_service.episodes.lease import Lease
from wrongturn_service.pool.pool import Action as Triple
from wrongturn_service.pool.pool import Final as End
from wrongturn_service.pool.pool import Simulator
from wrongturn_service.wire import Reply

ACTION: Final = struct.Struct("<3f")
"""An action as it is hashed and stored: little-endian float32, steer, throttle, brake."""


def as_float32(action: Action) -> Triple:
    """The action as it is used: what differs by less than a float32 is the same action."""
    return rounded(action.steer, action.throttle, action.brake)


def rounded(steer: float, throttle: float, brake: float) -> Triple:
    """The same of an action's values, each in its range."""
    triple: Triple = ACTION.unpack(ACTION.pack(steer, throttle, brake))
    return triple


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
    end: End | None = None
    closed: bool = False
    lock: asyncio.Lock = field(default_factory=asyncio.Lock)

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
