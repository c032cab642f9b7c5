"""Queue of calls that wait for a simulator. Each gets a reply at once, with its position and when to come back."""

import time
from collections import Counter
from collections.abc import Callable
from typing import Final

from wrongturn_protocol import ProblemType
from wrongturn_service.errors import UnavailableError, too_many
from wrongturn_service.simulators.interface import in_turn

LONGEST_S: Final = 10
"""Longest Retry-After, seconds."""
SLACK_S: Final = 2.0
"""Seconds that a place is kept after its Retry-After."""
Names = tuple[str, ...]
"""Address, owner and id of an agent."""


class SimulatorQueue:
    """Decides which call gets the next simulator, in the order of :func:`in_turn`."""

    def __init__(
        self, slots: Callable[[], int], each: int, most: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Create an empty queue for at most ``slots()`` simulators that drive at a time.

        At most ``each`` calls of an agent wait, and at most ``most`` of all agents. An agent is known by its address,
        owner and id, see :attr:`Payer.names`.
        """
        self._slots = slots
        self._each = each
        self._most = most
        self._clock = clock
        self._held: Counter[str] = Counter()
        self._taken = 0
        # Waiting calls in order of arrival, with the time at which the place is lost unless the call comes back.
        self._places: dict[tuple[Names, str], float] = {}

    @property
    def waiting(self) -> int:
        """Number of waiting calls."""
        self._forget()
        return len(self._places)

    def holds(self, agent: Names) -> tuple[int, ...]:
        """Return how many simulators an agent's address, its owner and the agent hold."""
        return tuple(self._held[name] for name in agent)

    def position(self, agent: Names, call: str) -> int:
        """Return how many simulators have to become free before it is a call's turn; 0 if it may claim one now."""
        free = self._slots() - self._taken
        if free > 0 and not self._places:
            return 0
        self._forget()
        order = in_turn(self._held, ((name[0], name) for name in {**self._places, (agent, call): 0.0}))
        return max(0, order.index((agent, call)) - free + 1)

    def enter(self, agent: Names, call: str) -> None:
        """Claim a simulator; :meth:`leave` gives it back. A call that comes back by its name has its old place.

        Raises:
            UnavailableError: All simulators are busy or other calls come first. ``position`` says how many simulators
                have to become free.
        """
        position, name = self.position(agent, call), (agent, call)
        if not position:
            self._places.pop(name, None)
            self._taken += 1
            self._held.update(agent)
            return
        if name not in self._places:
            self._check_room(agent)
        wait = min(LONGEST_S, 1 + (position - 1) // max(1, self._slots()))
        self._places[name] = self._clock() + wait + SLACK_S
        raise UnavailableError(
            ProblemType.SIMULATORS_BUSY,
            f"all {self._slots()} simulators are busy; this call is number {position} in the queue and keeps its place "
            f"if you send it again in {wait} s",
            retry_after_s=wait,
            position=position,
        )

    def leave(self, agent: Names) -> None:
        """Give a simulator back."""
        self._taken -= 1
        self._held -= Counter(agent)

    def _check_room(self, agent: Names) -> None:
        mine = sum(agent == waiting for waiting, _ in self._places)
        if mine >= self._each:
            detail = f"{mine} calls of this agent wait for a simulator, which is the limit; send those again first"
            raise too_many(detail, retry_after_s=LONGEST_S)
        if len(self._places) >= self._most:
            raise UnavailableError(
                ProblemType.SIMULATORS_BUSY,
                f"all {self._slots()} simulators are busy, and {len(self._places)} calls wait, which is the limit; "
                "come back later",
                retry_after_s=LONGEST_S,
                position=len(self._places) + 1,
            )

    def _forget(self) -> None:
        now = self._clock()
        late = [name for name, until in self._places.items() if until < now]
        for name in late:
            del self._places[name]
