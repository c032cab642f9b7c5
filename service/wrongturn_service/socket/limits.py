"""Limits for the number of connections to ``WS /v1/drive``."""

import contextlib
from collections import Counter
from collections.abc import Iterator

from wrongturn_protocol import ProblemType
from wrongturn_service.counting import one_less
from wrongturn_service.errors import UnavailableError

_COME_BACK_S = 5


class ConnectionLimits:
    """Counts open connections by agent and by address."""

    def __init__(self, *, each: int, address: int) -> None:
        """Set the limits.

        Args:
            each: connections of one agent.
            address: connections from one address.
        """
        self._each = each
        self._address = address
        self._agents: Counter[str] = Counter()
        self._addresses: Counter[str] = Counter()

    @property
    def open(self) -> int:
        """Number of open connections."""
        return self._agents.total()

    @contextlib.contextmanager
    def one(self, agent: str, address: str) -> Iterator[None]:
        """Count one more connection until the block ends.

        Args:
            agent: whose token opens it.
            address: where it comes from.

        Raises:
            UnavailableError: a limit is reached.
        """
        if self._agents[agent] >= self._each:
            raise _too_many(f"{self._each} connections of this agent")
        if self._addresses[address] >= self._address:
            raise _too_many(f"{self._address} connections from this address")
        self._agents[agent] += 1
        self._addresses[address] += 1
        try:
            yield
        finally:
            one_less(self._agents, agent)
            one_less(self._addresses, address)


def _too_many(which: str) -> UnavailableError:
    return UnavailableError(
        ProblemType.RATE_LIMITED,
        f"{which} are open, which is the limit; one carries any number of episodes, so use it, or close another",
        retry_after_s=_COME_BACK_S,
        status=429,
        position=1,
    )
