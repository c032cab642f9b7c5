"""Limits for the number of connections to ``WS /v1/drive``."""

import contextlib
from collections import Counter
from collections.abc import Iterator

from wrongturn_service.errors import too_many


class ConnectionLimits:
    """Counts open connections of an agent and from an address, which may be at most ``each`` and ``address``."""

    def __init__(self, *, each: int, address: int) -> None:
        self._each = each
        self._address = address
        self.open = 0
        """Number of open connections."""
        self._counts: Counter[str] = Counter()
        """By agent and by address. An id never looks like an address."""

    @contextlib.contextmanager
    def one(self, agent: str, address: str) -> Iterator[None]:
        """Count one more connection, opened with an agent's token from an address, until the block ends.

        Raises:
            UnavailableError: A limit is reached.
        """
        for who, whose, most in ((agent, "of this agent", self._each), (address, "from this address", self._address)):
            if self._counts[who] >= most:
                raise too_many(
                    f"{most} connections {whose} are open, which is the limit; one carries any number of episodes, so "
                    "use it, or close another"
                )
        self._counts.update((agent, address))
        self.open += 1
        try:
            yield
        finally:
            self.open -= 1
            self._counts -= Counter((agent, address))
