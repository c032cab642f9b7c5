"""Starts a runner for a check or a drive, talks with it, and ends it with all its processes.

A runner is a trusted program of ours, but it handles what strangers handed in. It gets none of the service's secrets,
and what it says is read strictly.
"""

import asyncio
import contextlib
import os
import signal
import sys
from collections.abc import AsyncIterator, Mapping, Sequence
from typing import Final

import structlog
from pydantic import ValidationError

from wrongturn_runner.messages import BUSY, EVENT, LAST, Event, Job, PracticeJob
from wrongturn_service.child_environment import child_environment

COMMAND: Final = (sys.executable, "-P", "-m", "wrongturn_runner")
"""Program of a runner. ``-P``: a file in the service's folder must not take the place of a package."""
_NICE: Final = 5
"""A runner gives way to the service and its simulators, which other agents use too."""
_LINE: Final = 64 * 1024
"""Longest message, bytes."""
_KEPT: Final = 8 * 1024
"""Bytes of a runner's stderr that are kept for the operator."""
_GRACE_S: Final = 2.0
"""Seconds that a runner gets to end by itself."""


class HaltedError(Exception):
    """The job was told to end: its submission is over, or the service stops."""


class RunnerLostError(Exception):
    """The runner ended without its last word, or said something that makes no sense. The model is not at fault."""


class NoRoomError(RunnerLostError):
    """The runner got no sandbox, because all of them are taken."""


class Runner:
    """A runner's process. Make it with :func:`runner`."""

    def __init__(self, process: asyncio.subprocess.Process, submission: str, halt: asyncio.Event) -> None:
        self.deadline: float | None = None
        """Time of the event loop by which the runner must have said its next word."""
        self._process = process
        self._halt = halt
        self._stderr = bytearray()
        self._drain = asyncio.create_task(self._keep_stderr())
        self._spoken = False
        self._log = structlog.get_logger("submissions").bind(submission=submission, runner=process.pid)

    async def send(self, message: Job | PracticeJob) -> None:
        """Send a message. A runner that is gone is noticed by :meth:`events`."""
        assert self._process.stdin is not None
        with contextlib.suppress(ConnectionError):
            self._process.stdin.write(message.model_dump_json().encode() + b"\n")
            await self._process.stdin.drain()

    async def events(self) -> AsyncIterator[Event]:
        """Yield what the runner says, until its last word.

        Raises HaltedError, and RunnerLostError if it ended before that, was too slow, or said what makes no sense.
        """
        while True:
            try:
                line = await self._line()
                if not line.endswith(b"\n"):
                    raise await self._how_it_ended()
                event = EVENT.validate_json(line)
            except ValidationError as error:
                raise RunnerLostError(f"the runner said what is no message: {error.errors()[0]['msg']}") from error
            except ValueError as error:  # asyncio's, for a line that is too long
                raise RunnerLostError(f"the runner said more than {_LINE} bytes in one message") from error
            self._spoken = isinstance(event, LAST)
            yield event
            if self._spoken:
                return

    async def _line(self) -> bytes:
        """Return the next line, what is left at the end of the stream, or nothing."""
        assert self._process.stdout is not None
        late = None if self.deadline is None else max(0.0, self.deadline - asyncio.get_running_loop().time())
        reading = asyncio.ensure_future(self._process.stdout.readline())
        halted = asyncio.ensure_future(self._halt.wait())
        try:
            await asyncio.wait((reading, halted), timeout=late, return_when=asyncio.FIRST_COMPLETED)
            if halted.done():
                raise HaltedError("the runner has to end")
            if not reading.done():
                raise RunnerLostError("the runner took too long")
            return reading.result()
        finally:
            halted.cancel()
            reading.cancel()

    async def end(self) -> None:
        """End the process and all of its group. Safe to call more than once."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
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
                while await self._process.stdout.read(_LINE):
                    pass
        self._drain.cancel()
        said = self._stderr.decode(errors="replace").strip()
        if said:
            self._log.warning("the runner wrote to stderr", status=status, stderr=said)

    def _signal(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, number)

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


@contextlib.asynccontextmanager
async def runner(
    job: Job,
    submission: str,
    command: Sequence[str] = COMMAND,
    halt: asyncio.Event | None = None,
    environment: Mapping[str, str] = os.environ,
) -> AsyncIterator[Runner]:
    """Start a runner and give it a job. Its whole process group is ended when the block ends.

    ``halt`` tells the job to end. The runner gets few of the variables of ``environment``. Raises RunnerLostError if
    it cannot be started.
    """
    try:
        process = await asyncio.create_subprocess_exec(
            *command,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            limit=_LINE,
            cwd="/",
            env=child_environment(environment=environment),
            start_new_session=True,
        )
    except OSError as error:
        raise RunnerLostError(f"no runner could be started: {error.strerror or error}") from error
    with contextlib.suppress(OSError):
        # Before its first thread, so that all threads and children inherit it.
        os.setpriority(os.PRIO_PROCESS, process.pid, _NICE)
    started = Runner(process, submission, halt or asyncio.Event())
    try:
        await started.send(job)
        yield started
    finally:
        await asyncio.shield(started.end())
