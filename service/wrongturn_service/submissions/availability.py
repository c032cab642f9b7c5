"""Whether submissions can be driven: it needs sandboxes, by bubblewrap or in a runner container, here or on Ray."""

import asyncio
import time
from collections.abc import Callable
from functools import partial
from typing import Final

import structlog

from wrongturn_protocol import ProblemType
from wrongturn_sandbox import SandboxUnavailableError, probe
from wrongturn_service.errors import UnavailableError
from wrongturn_service.settings import Place, Settings

LOOK_S: Final = 30.0
"""Seconds between two looks at sandboxes that may come and go."""
_FRESH_S: Final = 2.0
"""Seconds for which a look counts. Each takes a process, and anybody can ask for one."""
_PATIENCE_S: Final = 15.0
"""Seconds that a look may take."""
TURNED_OFF: Final = "WRONGTURN_SUBMISSIONS is 0"


class Availability:
    """Knows whether there are sandboxes, and looks again when that may have changed."""

    def __init__(self, settings: Settings, look: Callable[[], str] | None = None) -> None:
        """Know nothing yet. ``look`` takes the place of :func:`wrongturn_sandbox.probe`."""
        self._off = settings.submissions == 0
        self._comes_and_goes = settings.runner_socket is not None or settings.runners is Place.RAY
        self._look_s = LOOK_S if settings.runners is Place.LOCAL else 0.0  # what nodes have answered is known already
        self._look = look or partial(probe, settings.runner_socket)
        self._under_way: asyncio.Task[str] | None = None
        self._looked: float | None = None
        self._found: str | None = None
        self._told = ""
        self._reason = TURNED_OFF if self._off else "nobody has looked for sandboxes yet"
        self._log = structlog.get_logger("submissions")

    @property
    def on(self) -> bool:
        """Whether there were sandboxes at the last look."""
        return self._found is not None

    def __str__(self) -> str:
        """Return one line for people, such as ``on: bubblewrap 0.8.0``."""
        return f"off: {self._reason}" if self._found is None else f"on: {self._found}"

    async def look(self) -> bool:
        """Look for sandboxes, log a change, and return whether there are any."""
        if self._off:
            self._tell()
            return False
        try:
            # One look at a time: one that hangs keeps its thread.
            if self._under_way is None:
                self._under_way = asyncio.create_task(asyncio.to_thread(self._look))
                self._under_way.add_done_callback(self._looked_once)
            self._found = await asyncio.wait_for(asyncio.shield(self._under_way), _PATIENCE_S)
        except SandboxUnavailableError as error:
            self._found, self._reason = None, str(error)
        except TimeoutError:
            self._found, self._reason = None, f"the sandboxes did not answer within {_PATIENCE_S:g} s"
        self._looked = time.monotonic()
        self._tell()
        return self.on

    def _tell(self) -> None:
        """Log what was found if that makes a difference."""
        told = "on" if self.on else str(self)
        if told != self._told:
            self._told = told
            (self._log.info if self.on or self._off else self._log.warning)(f"submissions {self}")

    def _looked_once(self, task: "asyncio.Task[str]") -> None:
        self._under_way = None
        if not task.cancelled():
            task.exception()  # a look that took too long has nobody who waits for it

    async def look_if_due(self) -> None:
        """Look again if there were no sandboxes, or if they can go, every :data:`LOOK_S`."""
        due = self._looked is None or time.monotonic() - self._looked >= self._look_s
        if due and (self._comes_and_goes or not self.on):
            await self.look()

    async def check(self) -> None:
        """Check that a submission can be taken. Raises UnavailableError, whose detail says why there is no sandbox."""
        stale = self._looked is None or time.monotonic() - self._looked >= _FRESH_S
        if not self.on and stale and not self._off:
            await self.look()
        if not self.on:
            raise UnavailableError(
                ProblemType.SUBMISSIONS_UNAVAILABLE,
                f"this service takes no submissions now: {self._reason}",
                retry_after_s=3600 if self._off else round(LOOK_S),
            )
