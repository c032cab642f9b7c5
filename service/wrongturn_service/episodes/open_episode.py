"""An open episode in memory: enough to replay it in another simulator, and its agent's lease on it."""

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, auto

from wrongturn_protocol import Track, Trial
from wrongturn_service.encoding import Reply
from wrongturn_service.simulators.actions import ACTION, Action
from wrongturn_service.simulators.interface import EpisodeEnd, Simulator


class Standing(Enum):
    """What an agent's silence leads to."""

    HELD = auto()
    """The agent keeps its simulator."""
    RELEASE = auto()
    """The simulator is released. It is rebuilt when the agent comes back."""
    EXPIRED = auto()
    """The episode ends as ``aborted``."""


@dataclass(frozen=True)
class LeaseLimits:
    """Limits of an agent's silence."""

    release_s: float
    """Seconds after which the simulator is released: ``WRONGTURN_LEASE_RELEASE_S``, 10 by default."""
    abort_s: float
    """Seconds after which the episode is aborted: ``WRONGTURN_LEASE_ABORT_S``, 600 by default."""

    @property
    def period_s(self) -> float:
        """Seconds between two checks: at most a quarter of the shorter limit."""
        return min(1.0, self.release_s / 4, self.abort_s / 4)


class Lease:
    """One agent's hold on one episode."""

    def __init__(self, limits: LeaseLimits, clock: Callable[[], float] = time.monotonic) -> None:
        self._limits = limits
        self._clock = clock
        self._heard = clock()

    def renew(self) -> None:
        """Start the agent's time of silence anew."""
        self._heard = self._clock()

    @property
    def silence_s(self) -> float:
        """Seconds since the agent last sent something."""
        return self._clock() - self._heard

    @property
    def standing(self) -> Standing:
        """What the silence leads to now."""
        silence = self.silence_s
        if silence >= self._limits.abort_s:
            return Standing.EXPIRED
        return Standing.RELEASE if silence >= self._limits.release_s else Standing.HELD


@dataclass(frozen=True, slots=True)
class Payer:
    """The agent, owner and address whose limits an open episode uses."""

    holder: str
    """Id of who drives it: the agent, or the submission whose runner does."""
    owner: str
    """Id of the agent's owner."""
    address: str | None
    """The address that has begun it. None for a runner, whose address is the service's own."""


@dataclass(eq=False)
class OpenEpisode:
    """An episode that an agent drives."""

    id: str
    payer: Payer
    evaluation: str | None
    """Id of the evaluation, None in practice."""
    trial: Trial
    track: Track
    last: Reply
    """The last reply."""
    lease: Lease
    actions: bytearray = field(default_factory=bytearray)
    """All actions so far, little-endian float32 [n, 3]."""
    simulator: Simulator | None = None
    """None while it is released or dead."""
    counts: bool = False
    """Whether the evaluation is known to have had a step, so that it counts; true in practice."""
    placed: bool = False
    """Whether the episode holds a place of the queue, with or without a simulator."""
    end: EpisodeEnd | None = None
    """The end, once the episode is over."""
    closed: bool = False
    """Whether the episode is stored or given up. From then on only the database knows it."""
    lock: asyncio.Lock = field(default_factory=asyncio.Lock)

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
    def last_action(self) -> Action | None:
        """Action of the last step, None before the first."""
        if not self.actions:
            return None
        steer, throttle, brake = ACTION.unpack_from(self.actions, len(self.actions) - ACTION.size)
        return steer, throttle, brake

    def locked_now(self) -> bool:
        """Acquire the lock without waiting and return whether that worked."""
        if self.lock.locked():
            return False
        attempt = self.lock.acquire()
        try:
            attempt.send(None)
        except StopIteration:
            return True
        attempt.close()  # another task was just woken to take it
        return False
