"""Rendered pages, kept until a leaderboard changes."""

import asyncio
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Hashable
from typing import Final

CAPACITY: Final = 64
"""Number of pages that are kept. The page of a hundred agents has about 200 kB."""


class RenderedPages:
    """The pages that were asked for last. All are dropped when a leaderboard changes."""

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._pages: OrderedDict[Hashable, bytes] = OrderedDict()
        self._capacity = capacity
        self._generation = -1
        self._lock = asyncio.Lock()

    async def get(self, generation: int, key: Hashable, render: Callable[[], Awaitable[bytes]]) -> bytes:
        """Return a page. It is rendered if it is not kept; one page is rendered at a time.

        Args:
            generation: Generation of the leaderboards, read before the page is rendered.
            key: What decides the page, apart from the leaderboards.
            render: Renders the page.
        """
        if generation > self._generation:
            self._generation = generation
            self._pages.clear()
        if (page := self._kept(key)) is not None:
            return page
        async with self._lock:
            if (page := self._kept(key)) is not None:
                return page
            page = await render()
            if generation == self._generation:
                self._pages[key] = page
                if len(self._pages) > self._capacity:
                    self._pages.popitem(last=False)
            return page

    def _kept(self, key: Hashable) -> bytes | None:
        if key not in self._pages:
            return None
        self._pages.move_to_end(key)
        return self._pages[key]
