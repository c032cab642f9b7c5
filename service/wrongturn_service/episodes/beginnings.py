"""Resets that are under way: who asks which episodes are open is told of these too, once they are."""

import asyncio
import contextlib
from collections.abc import Iterator
from typing import Final

from wrongturn_protocol import ProblemType
from wrongturn_service.errors import UnavailableError

PATIENCE_S: Final = 20.0
"""Seconds for which they are waited for; less than a client waits for an answer."""


class Beginnings:
    """Resets by their evaluation, from their arrival to their reply.

    An agent that was killed while it waited for a reset's reply would else come back, find nothing open and go on,
    and the episode would be begun after that for nobody.
    """

    def __init__(self) -> None:
        self._under_way: dict[str, set[asyncio.Event]] = {}

    @contextlib.contextmanager
    def one(self, evaluation_id: str) -> Iterator[None]:
        """A reset is under way for as long as the block lasts."""
        over = asyncio.Event()
        others = self._under_way.setdefault(evaluation_id, set())
        others.add(over)
        try:
            yield
        finally:
            over.set()
            others.discard(over)
            if not others:
                self._under_way.pop(evaluation_id, None)

    async def over(self, evaluation_id: str, patience_s: float = PATIENCE_S) -> None:
        """Wait until those are over that are under way now.

        Raises:
            UnavailableError: they take too long.
        """
        try:
            async with asyncio.timeout(patience_s):
                for event in list(self._under_way.get(evaluation_id, ())):
                    await event.wait()
        except TimeoutError as error:
            raise UnavailableError(
                ProblemType.SIMULATORS_BUSY,
                f"an episode of evaluation {evaluation_id} is just being begun; ask again",
                retry_after_s=1,
            ) from error
