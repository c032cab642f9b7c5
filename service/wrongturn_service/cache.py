"""Cache of costly work whose results do not change, such as what pages show, or may be a second old, such as lists."""

import asyncio
import math
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Hashable
from typing import Any, Final, TypeVar

_T = TypeVar("_T")
_CAPACITY: Final = 32
_AT_ONCE: Final = 2


class Cache:
    """The results that were asked for last, up to a capacity: their number, or the sum of their sizes.

    Only ``at_once`` are made at once, and none twice at once. A result larger than the capacity is not cached. With
    ``keep_s`` none is used for longer than that.
    """

    def __init__(
        self,
        capacity: int = _CAPACITY,
        at_once: int = _AT_ONCE,
        size: Callable[[Any], int] = lambda _: 1,
        keep_s: float = math.inf,
    ) -> None:
        self._capacity = capacity
        self._size = size
        self._keep_s = keep_s
        self._filled = 0
        self._cleared = 0
        self._found: OrderedDict[Hashable, Any] = OrderedDict()
        self._making: dict[Hashable, asyncio.Task[Any]] = {}
        self._turn = asyncio.Semaphore(at_once)

    async def get(self, key: Hashable, make: Callable[[], Awaitable[_T]]) -> _T:
        """Return what ``make`` returns, or what it returned before under this key, which alone decides the result.

        The work goes on if the caller is cancelled, because others may wait for it. Costly parts belong into a thread.
        """
        key = time.monotonic() // self._keep_s, key
        if key in self._found:
            self._found.move_to_end(key)
            found: _T = self._found[key]
            return found
        task = self._making.get(key)
        if task is None:
            task = asyncio.ensure_future(self._make(key, make, self._cleared))
            self._making[key] = task
            task.add_done_callback(lambda made: self._over(key, made))
        made: _T = await asyncio.shield(task)
        return made

    def clear(self) -> None:
        """Drop all results. What is being made now is not cached either."""
        self._cleared += 1
        self._found.clear()
        self._making.clear()
        self._filled = 0

    def _over(self, key: Hashable, task: "asyncio.Task[Any]") -> None:
        if self._making.get(key) is task:
            del self._making[key]

    async def _make(self, key: Hashable, make: Callable[[], Awaitable[_T]], cleared: int) -> _T:
        async with self._turn:
            result = await make()
        if cleared == self._cleared and self._size(result) <= self._capacity:
            self._found[key] = result
            self._filled += self._size(result)
        while self._filled > self._capacity:
            _, gone = self._found.popitem(last=False)
            self._filled -= self._size(gone)
        return result
