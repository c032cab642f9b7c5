"""What the service says to a runner and hears of it, wherever the runner's process is.

A runner is a trusted program of ours, but it handles what strangers handed in. It gets none of the service's secrets,
and what it says is read strictly.
"""

import abc
import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Final, Protocol

from pydantic import ValidationError

from wrongturn_runner.messages import EVENT, LAST, Event, Job, PracticeJob

LINE: Final = 64 * 1024
"""Longest message, bytes."""


class HaltedError(Exception):
    """The job was told to end: its submission is over, or the service stops."""


class RunnerLostError(Exception):
    """The runner ended without its last word, or said something that makes no sense. The model is not at fault."""


class NoRoomError(RunnerLostError):
    """The runner got no sandbox, because all of them are taken or none can be reached."""


class Runner(abc.ABC):
    """A runner that has its job. A subclass knows its process."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, halt: asyncio.Event) -> None:
        """Speak with a runner; ``halt`` tells the job to end."""
        self.deadline: float | None = None
        """Time of the event loop by which the runner must have said its next word."""
        self._reader = reader
        self._writer = writer
        self._halt = halt
        self._spoken = False

    @abc.abstractmethod
    async def end(self) -> None:
        """End its processes. Safe to call more than once."""

    @abc.abstractmethod
    async def _how_it_ended(self) -> RunnerLostError:
        """Return why it says nothing more."""

    async def send(self, message: Job | PracticeJob) -> None:
        """Send a message. A runner that is gone is noticed by :meth:`events`."""
        with contextlib.suppress(OSError):
            self._writer.write(message.model_dump_json().encode() + b"\n")
            await self._writer.drain()

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
                raise RunnerLostError(f"the runner said more than {LINE} bytes in one message") from error
            self._spoken = isinstance(event, LAST)
            yield event
            if self._spoken:
                return

    async def _line(self) -> bytes:
        """Return the next line, what is left at the end of the stream, or nothing."""
        late = None if self.deadline is None else max(0.0, self.deadline - asyncio.get_running_loop().time())
        reading = asyncio.ensure_future(self._reader.readline())
        halted = asyncio.ensure_future(self._halt.wait())
        try:
            await asyncio.wait((reading, halted), timeout=late, return_when=asyncio.FIRST_COMPLETED)
            if halted.done():
                raise HaltedError("the runner has to end")
            if not reading.done():
                raise RunnerLostError("the runner took too long")
            with contextlib.suppress(OSError):  # its machine is gone
                return reading.result()
            return b""
        finally:
            halted.cancel()
            reading.cancel()


class Runners(Protocol):
    """Where runners run."""

    def open(self, url: str) -> None:
        """Begin, once the service listens at a URL."""

    def start(self, job: Job, submission: str, halt: asyncio.Event) -> contextlib.AbstractAsyncContextManager[Runner]:
        """Start a runner, give it a job, and end it when the block ends.

        ``halt`` tells the job to end. Raises RunnerLostError if it cannot be started.
        """

    async def close(self) -> None:
        """Start no more. Safe to call more than once."""
