"""How long an agent may be silent: soon its simulator goes to others, later its episode is over."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto


class Standing(Enum):
    """What an agent's silence has come to."""

    HELD = auto()
    """The simulator is kept for it."""
    RELEASE = auto()
    """The simulator goes to others, and is rebuilt when the agent comes back."""
    EXPIRED = auto()
    """The episode is ``aborted``."""


@dataclass(frozen=True)
class Terms:
    """The limits.

    Attributes:
        release_s: seconds of silence after which the simulator is released.
        abort_s: seconds of silence after which the episode is aborted.
    """

    release_s: float
    abort_s: float

    @property
    def period_s(self) -> float:
        """How often to look, seconds: often enough to be in time by a quarter of the shorter limit."""
        return min(1.0, self.release_s / 4, self.abort_s / 4)


class Lease:
    """One agent's hold on one episode."""

    def __init__(self, terms: Terms, clock: Callable[[], float] = time.monotonic) -> None:
        self._terms = terms
        self._clock = clock
        self._heard = clock()

    def renew(self, ago_s: float = 0.0) -> None:
        """The agent was heard of, so many seconds ago; it may have been heard of since."""
        self._heard = max(self._heard, self._clock() - ago_s)

    @property
    def silence_s(self) -> float:
        """Seconds since the agent was heard of."""
        return self._clock() - self._heard

    @property
    def standing(self) -> Standing:
        """What the silence has come to."""
        silence = self.silence_s
        if silence >= self._terms.abort_s:
            return Standing.EXPIRED
        return Standing.RELEASE if silence >= self._terms.release_s else Standing.HELD

    @property
    def expired(self) -> bool:
        """Whether the silence has lasted too long."""
        return self.standing is Standing.EXPIRED
