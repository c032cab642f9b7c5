"""Who gets the next simulator: nobody waits unanswered, but has a place in a line that is kept for coming back."""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from wrongturn_protocol import ProblemType
from wrongturn_service.errors import UnavailableError

LONGEST_S: Final = 10
"""Seconds after which the last in a long line are asked to come back."""
SLACK_S: Final = 2.0
"""Seconds that a place is kept beyond the time at which its owner was to come back."""


@dataclass(frozen=True, slots=True)
class Limits:
    """How long the line may get.

    Attributes:
        each: calls of one agent that may stand in it.
        all: calls that may stand in it.
    """

    each: int
    all: int


@dataclass(slots=True)
class _Place:
    """One call's in the line."""

    agent: str
    since: int
    """Counts up with each that comes."""
    until: float
    """When it is given up, unless its owner comes back before."""


class SimulatorQueue:
    """Hands out the places at simulators.

    Of two agents the one that has fewer simulators comes first, each of its waiting calls counting as one more; where
    they are equal, who came first. So an agent that asks for a hundred does not keep out one that asks for its first,
    and nobody who comes back in time is overtaken by a call that came later from an agent that has as many.
    """

    def __init__(self, slots: int, limits: Limits, clock: Callable[[], float] = time.monotonic) -> None:
        """Nobody waits yet.

        Args:
            slots: simulators that drive at most.
            limits: of the line.
            clock: seconds.
        """
        self._slots = slots
        self._limits = limits
        self._clock = clock
        self._held: Counter[str] = Counter()
        self._taken = 0
        self._places: dict[tuple[str, str], _Place] = {}
        self._count = 0

    @property
    def waiting(self) -> int:
        """Calls that have a place in the line."""
        self._forget()
        return len(self._places)

    def enter(self, agent: str, call: str) -> None:
        """Take a simulator's place; :meth:`leave` gives it back.

        Args:
            agent: who wants it.
            call: what for: who comes back for the same stands where it stood.

        Raises:
            UnavailableError: others come first, or all drive; the position says how many have to be done before.
        """
        free = self._slots - self._taken
        if free > 0 and not self._places:
            self._take(agent)
            return
        self._forget()
        name = (agent, call)
        place = self._places.get(name)
        if place is None:
            place = self._queue(name)
        ahead = self._order().index(name)
        if ahead < free:
            del self._places[name]
            self._take(agent)
            return
        position = ahead - free + 1
        wait = min(LONGEST_S, 1 + (position - 1) // self._slots)
        place.until = self._clock() + wait + SLACK_S
        raise UnavailableError(
            ProblemType.SIMULATORS_BUSY,
            f"all {self._slots} simulators are busy or promised; this call is number {position} in the line, and its "
            f"place is kept if it comes back in {wait} s",
            retry_after_s=wait,
            position=position,
        )

    def leave(self, agent: str) -> None:
        """Give a simulator's place back."""
        self._taken -= 1
        self._held[agent] -= 1
        if not self._held[agent]:
            del self._held[agent]

    def _take(self, agent: str) -> None:
        self._taken += 1
        self._held[agent] += 1

    def _queue(self, name: tuple[str, str]) -> _Place:
        agent = name[0]
        mine = sum(place.agent == agent for place in self._places.values())
        if mine >= self._limits.each:
            raise UnavailableError(
                ProblemType.RATE_LIMITED,
                f"{mine} calls of this agent wait for a simulator, which is as many as may; come back for those first",
                retry_after_s=LONGEST_S,
                status=429,
                position=1,
            )
        if len(self._places) >= self._limits.all:
            raise UnavailableError(
                ProblemType.SIMULATORS_BUSY,
                f"all {self._slots} simulators are busy, and {len(self._places)} calls wait for one, which is as many "
                "as may; come back later",
                retry_after_s=LONGEST_S,
                position=len(self._places) + 1,
            )
        self._count += 1
        place = self._places[name] = _Place(agent, self._count, self._clock() + LONGEST_S)
        return place

    def _order(self) -> list[tuple[str, str]]:
        """The line, from its front."""
        counted = Counter(self._held)
        ranked = []
        for name, place in self._places.items():  # in the order in which they came
            ranked.append((counted[place.agent], place.since, name))
            counted[place.agent] += 1
        return [name for _, _, name in sorted(ranked)]

    def _forget(self) -> None:
        now = self._clock()
        late = [name for name, place in self._places.items() if place.until < now]
        for name in late:
            del self._places[name]
