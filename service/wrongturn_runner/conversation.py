"""The runner's side of its conversation with the service: messages in, events out, and the end of either."""

import contextlib
import os
import queue
import select
import sys
import threading
from typing import Final

from pydantic import ValidationError

from wrongturn_runner.errors import RunnerFailedError
from wrongturn_runner.messages import JOB, Described, Driven, Event, Job, Passed, PracticeJob, Progressed, Refused

FAILED: Final = 1
"""Exit status of a runner that did not finish its work."""


class Conversation:
    """Reads from stdin and writes to stdout until the service goes away, which ends this process at once.

    Nothing has to be put away then: the episodes are the service's, and a sandbox ends with its runner.
    """

    def __init__(self) -> None:
        """Take over stdin and stdout; what else prints to stdout goes to stderr from now on."""
        self._out = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        self._lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._status = FAILED
        self._writing = threading.Lock()
        # A pidfd and not PR_SET_PDEATHSIG, which fires as soon as the thread ends that started this process.
        self._parent = _pidfd(os.getppid())
        threading.Thread(target=self._listen, daemon=True).start()

    def job(self) -> Job:
        """Wait for the first message and return it. Raises RunnerFailedError if it is not a job."""
        try:
            return JOB.validate_json(self._lines.get())
        except ValidationError as error:
            raise _unreadable(error) from None

    def practice(self) -> PracticeJob:
        """Wait for the answer to ``described`` and return it; raises as :meth:`job`."""
        try:
            return PracticeJob.model_validate_json(self._lines.get())
        except ValidationError as error:
            raise _unreadable(error) from None

    def tell(self, event: Described | Progressed) -> None:
        """Write an event that others follow."""
        with self._writing:
            self._write(event)

    def finish(self, event: Passed | Refused | Driven) -> None:
        """Write the last event."""
        with self._writing:
            self._status = 0  # the service may close stdin as soon as it has read the event
            self._write(event)

    def _write(self, event: Event) -> None:
        try:
            self._out.write(event.model_dump_json() + "\n")
            self._out.flush()
        except BrokenPipeError:
            os._exit(FAILED)

    def _listen(self) -> None:
        stdin = sys.stdin.fileno()
        watch = select.poll()
        for source in (stdin, self._parent):
            if source is not None:
                watch.register(source, select.POLLIN)
        begun = b""
        while True:
            ready = [source for source, _ in watch.poll()]
            read = os.read(stdin, 1 << 16) if stdin in ready else None
            if read == b"" or self._parent in ready:
                os._exit(self._status)
            *lines, begun = (begun + (read or b"")).split(b"\n")
            for line in lines:
                self._lines.put(line)


def _pidfd(process: int) -> int | None:
    """Return a descriptor that can be read once a process has ended; None where the kernel has none."""
    with contextlib.suppress(OSError):
        return os.pidfd_open(process)
    return None


def _unreadable(error: ValidationError) -> RunnerFailedError:
    # Without the input: it holds a token.
    first = error.errors(include_url=False, include_input=False)[0]
    where = ".".join(map(str, first["loc"])) or "message"
    return RunnerFailedError(f"stdin: {where}: {first['msg']}; is the runner of the service's version?")
