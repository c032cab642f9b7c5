"""Blocking calls made awaitable by threads."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from types import TracebackType
from typing import ParamSpec, Self, TypeVar

from wrongturn_client.closing import Closing

P = ParamSpec("P")
T = TypeVar("T")


class Threaded:
    """Base of what awaits the calls of something that blocks."""

    def __init__(self, blocking: Closing, threads: int, name: str) -> None:
        """Start no thread yet.

        Args:
            blocking: whose calls are awaited; it is closed with this.
            threads: calls at a time; more wait for these.
            name: of the threads.
        """
        self._blocking = blocking
        self._threads = ThreadPoolExecutor(threads, name)

    async def __aenter__(self) -> Self:
        """Itself."""
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close."""
        await self.close()

    async def close(self) -> None:
        """Close the connections; open episodes stay open."""
        await self._run(self._blocking.close)
        self._threads.shutdown(wait=False)

    async def _run(self, call: Callable[P, T], *arguments: P.args, **keywords: P.kwargs) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._threads, partial(call, *arguments, **keywords))
