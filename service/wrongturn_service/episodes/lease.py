"""How long an agent may be silent before it loses its simulator, and before its episode is aborted."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto


class Standing(Enum):
    """What an agent's silence leads to."""

    HELD = auto()
    """The agent keeps its simulator."""
    RELEASE = auto()
    """The simulator is released. It is rebuilt when the agent comes back."""
    EXPIRED = auto()
    """The episode ends as ``aborted``."""


@dataclass(frozen=True)
class Terms:
    """Limits of an agent's silence.

    Attributes:
        release_s: Seconds after which the simulator is released: ``WRONGTURN_LEASE_RELEASE_S``, 10 by default.
        abort_s: Seconds after which the episode is aborted: ``WRONGTURN_LEASE_ABORT_S``, 600 by default.
    """

    release_s: float
    abort_s: float

    @property
    def period_s(self) -> float:
        """Seconds between two checks: at most a quarter of the shorter limit."""
        return min(1.0, self.release_s / 4, self.abort_s / 4)


class Lease:
    """One agent's hold on one episode."""

    def __init__(self, terms: Terms, clock: Callable[[], float] = time.monotonic) -> None:
        self._terms = terms
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
        if silence >= self._terms.abort_s:
            return Standing.EXPIRED
        return Standing.RELEASE if silence >= self._terms.release_s else Standing.HELD

    @property
    def expired(self) -> bool:
        """Whether the episode has to be aborted."""
        return self.standing is Standing.EXPIRED
