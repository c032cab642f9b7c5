"""Draws of suites. Those whose towns the secret makes come from a background process, which no call waits for."""

import asyncio
import contextlib
import json
import os
import signal
import sys
import time
from collections import OrderedDict
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import structlog

from wrongturn_networks import Draw, Suite
from wrongturn_networks.drawn import is_built, is_drawn
from wrongturn_protocol import ProblemType, Trial
from wrongturn_service.child_environment import child_environment
from wrongturn_service.errors import UnavailableError

_KEPT: Final = 64
"""Draws that are kept. One of 120 trials has about 200 kB."""
_AGAIN_S: Final = 2
"""Seconds after which a call that needs the towns should come again."""
_AFTER_FAILURE_S: Final = 30.0
"""Seconds between two attempts to build towns."""
_WAITS_S: Final = 10.0
"""Seconds for which a call that was sent again later counts as waiting."""
_LONGEST_S: Final = 600.0
"""Seconds after which a process that builds towns is ended."""
_LOOK_S: Final = 0.5
_COMMAND: Final = (sys.executable, "-m", "wrongturn_service.episodes.towns")
_PASSED_ON: Final = ("NUMBA_CACHE_DIR", "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "WRONGTURN_TOWNS", "WRONGTURN_SUITES")
_Key = tuple[str, str]
"""Id of a suite and a secret; or an empty id and the names of towns."""


class Draws:
    """Makes draws, one after the other, and keeps those that needed towns."""

    def __init__(self, home: Path) -> None:
        self._home = home
        self._made: OrderedDict[_Key, Draw] = OrderedDict()
        self._wanted: dict[_Key, float] = {}
        self._failed: dict[_Key, tuple[float, str]] = {}
        # One after the other, since each uses all cores of the machine.
        self._builder: asyncio.Task[None] | None = None
        self._log = structlog.get_logger("towns")

    def get(self, suite: Suite, secret: str) -> Draw:
        """Return the trials that a secret draws of a suite.

        Raises UnavailableError while the secret's towns are built, which this call begins if nobody has.
        """
        if not suite.makes_towns:
            return suite.draw(secret)
        key = suite.id, secret
        if key in self._made:
            self._made.move_to_end(key)
            return self._made[key]
        self._begin(key)
        raise self._not_yet(key)

    def open_draw(self, suite: Suite) -> Draw:
        """Return the open draw of a suite. Raises as :meth:`get`."""
        return suite.open_draw if not suite.makes_towns else self.get(suite, suite.id)

    def prepare(self, suite: Suite, secret: str) -> None:
        """Begin to build the towns of a secret, if there are any."""
        with contextlib.suppress(UnavailableError):
            self.get(suite, secret) if suite.makes_towns else None

    def check_towns(self, trials: Iterable[Trial]) -> None:
        """Check that the towns of driven trials are still built. Raises UnavailableError while they are not."""
        names = sorted({trial.town for trial in trials if is_drawn(trial.town)})
        if missing := [name for name in names if not is_built(name)]:
            key = "", " ".join(missing)
            self._begin(key)
            raise self._not_yet(key)

    async def stop(self) -> None:
        """End what is being built; what is finished stays."""
        if self._builder is not None:
            self._builder.cancel()
            await asyncio.wait([self._builder])

    def _not_yet(self, key: _Key) -> UnavailableError:
        if key in self._failed and key not in self._wanted:
            detail = f"the towns of this draw cannot be built: {self._failed[key][1]}; the operator's log says more"
            return UnavailableError(ProblemType.TOWNS_NOT_BUILT, detail, retry_after_s=int(_AFTER_FAILURE_S))
        return UnavailableError(
            ProblemType.TOWNS_NOT_BUILT,
            "the towns of this draw are being built, which takes some seconds; come again",
            retry_after_s=_AGAIN_S,
        )

    def _begin(self, key: _Key) -> None:
        failed = self._failed.get(key)
        if failed is not None and time.monotonic() - failed[0] <= _AFTER_FAILURE_S:
            return
        self._wanted[key] = time.monotonic()
        if self._builder is None or self._builder.done():
            self._builder = asyncio.create_task(self._build())

    async def _build(self) -> None:
        """Build what is wanted. First comes who still asks: an evaluation that nobody drives must not delay others."""
        while self._wanted:
            now = time.monotonic()
            waiting = [key for key, asked in self._wanted.items() if now - asked < _WAITS_S]
            key = next(iter(waiting or self._wanted))
            await self._make(key)
            del self._wanted[key]

    async def _make(self, key: _Key) -> None:
        began = time.monotonic()
        try:
            drawn = await self._run(key)
        except Exception as error:
            self._failed[key] = time.monotonic(), str(error)
            self._log.exception("towns not built", suite=key[0])
        else:
            self._failed.pop(key, None)
            if drawn is not None:
                self._made[key] = drawn
                while len(self._made) > _KEPT:
                    self._made.popitem(last=False)
            self._log.info("towns built", suite=key[0], seconds=round(time.monotonic() - began, 1))

    async def _run(self, key: _Key) -> Draw | None:
        """Run the process that builds towns, and return the draw that it makes; None if only towns were asked for."""
        process = await asyncio.create_subprocess_exec(
            *_COMMAND,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            env={**child_environment(*_PASSED_ON), "WRONGTURN_HOME": str(self._home)},
            start_new_session=True,
        )
        talk = asyncio.ensure_future(process.communicate(json.dumps(key).encode()))
        try:
            async with asyncio.timeout(_LONGEST_S):
                while process.returncode is None:
                    await asyncio.wait([talk], timeout=_LOOK_S)
        except TimeoutError as error:
            raise RuntimeError(f"that took more than {_LONGEST_S:.0f} s") from error
        finally:
            # Its own processes live on where somebody kills it, and hold its pipes.
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            said, complained = await talk
        if process.returncode:
            raise RuntimeError(complained.decode(errors="replace").strip().rpartition("\n")[2] or "the process died")
        if not key[0]:
            return None
        told = json.loads(said)
        trials, twins = (tuple(Trial.model_validate(one) for one in told[name]) for name in ("trials", "twins"))
        return Draw(key[0], trials, twins, key[1])
