"""Runners as processes of this machine."""

import asyncio
import contextlib
import os
import signal
import sys
from collections.abc import AsyncIterator, Mapping, Sequence
from typing import Final

import structlog
from typing_extensions import override

from wrongturn_runner.messages import BUSY, Job
from wrongturn_service.child_environment import NICE, child_environment
from wrongturn_service.submissions.runners import LINE, NoRoomError, Runner, RunnerLostError

COMMAND: Final = (sys.executable, "-P", "-m", "wrongturn_runner")
"""Program of a runner. ``-P``: a file in the service's folder must not take the place of a package."""
_KEPT: Final = 8 * 1024
"""Bytes of a runner's stderr that are kept for the operator."""
_GRACE_S: Final = 2.0
"""Seconds that a runner gets to end by itself."""


class LocalRunner(Runner):
    """A runner's process and all of its group."""

    def __init__(self, process: asyncio.subprocess.Process, submission: str, halt: asyncio.Event) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        super().__init__(process.stdout, process.stdin, halt)
        self._process = process
        self._stderr = bytearray()
        self._drain = asyncio.create_task(self._keep_stderr())
        self._log = structlog.get_logger("submissions").bind(submission=submission, runner=process.pid)

    @override
    async def end(self) -> None:
        self._writer.close()
        if not self._spoken:
            self._signal(signal.SIGTERM)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_GRACE_S):
                await self._process.wait()
        # Also what is left of the group of a runner that has ended.
        self._signal(signal.SIGKILL)
        status = await self._process.wait()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_GRACE_S):  # a process that left the group may hold the pipes open
                await self._drain
                # What nobody waits for: a pipe is closed at its end alone.
                while await self._reader.read(LINE):
                    pass
        self._drain.cancel()
        said = self._stderr.decode(errors="replace").strip()
        if said:
            self._log.warning("the runner wrote to stderr", status=status, stderr=said)

    def _signal(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, number)

    @override
    async def _how_it_ended(self) -> RunnerLostError:
        try:
            async with asyncio.timeout(_GRACE_S):
                status = await self._process.wait()
        except TimeoutError:
            return RunnerLostError("the runner closed its stdout")
        if status == BUSY:
            return NoRoomError("all sandboxes are taken")
        how = f"was ended by signal {-status}" if status < 0 else f"ended with status {status}"
        return RunnerLostError(f"the runner {how}")

    async def _keep_stderr(self) -> None:
        assert self._process.stderr is not None
        while part := await self._process.stderr.read(_KEPT):
            self._stderr += part
            del self._stderr[:-_KEPT]


class LocalRunners:
    """Starts runners on this machine."""

    def __init__(self, command: Sequence[str] = COMMAND, environment: Mapping[str, str] = os.environ) -> None:
        """``command`` is the program of a runner. It gets few of the variables of ``environment``."""
        self._command = command
        self._environment = environment

    def open(self, url: str) -> None:
        """Do nothing: a job holds the service's URL."""

    @contextlib.asynccontextmanager
    async def start(self, job: Job, submission: str, halt: asyncio.Event) -> AsyncIterator[LocalRunner]:
        """Start a runner as :meth:`Runners.start` says. Its whole process group is ended when the block ends."""
        try:
            process = await asyncio.create_subprocess_exec(
                *self._command,
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.PIPE,
                limit=LINE,
                cwd="/",
                env=child_environment(environment=self._environment),
                start_new_session=True,
            )
        except OSError as error:
            raise RunnerLostError(f"no runner could be started: {error.strerror or error}") from error
        with contextlib.suppress(OSError):
            # Before its first thread, so that all threads and children inherit it.
            os.setpriority(os.PRIO_PROCESS, process.pid, NICE)
        started = LocalRunner(process, submission, halt)
        try:
            await started.send(job)
            yield started
        finally:
            await asyncio.shield(started.end())

    async def close(self) -> None:
        """Do nothing: each job ends its own runner."""
