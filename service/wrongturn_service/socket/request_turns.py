"""The turns in which the requests of all connections begin."""

import asyncio
from collections import deque
from collections.abc import Callable


class RequestTurns:
    """Begins requests one after the other, one in each turn of the event loop.

    All that came together in one turn would delay a step, which takes several turns, by several times their number.
    """

    def __init__(self) -> None:
        self._waiting: deque[Callable[[], None]] = deque()
        self._taken = False

    def take(self, begin: Callable[[], None]) -> None:
        """Call a function: now, or once all earlier ones had their turns."""
        if self._taken:
            self._waiting.append(begin)
        else:
            self._begin(begin)

    def _begin(self, begin: Callable[[], None]) -> None:
        self._taken = True
        asyncio.get_running_loop().call_soon(self._next)
        begin()

    def _next(self) -> None:
        self._taken = False
        if self._waiting:
            self._begin(self._waiting.popleft())
