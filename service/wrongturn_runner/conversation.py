"""The runner's side of its conversation with the service: messages in, events out, and the end of either."""

import os
import queue
import sys
import threading
from typing import Final, TypeVar

from pydantic import TypeAdapter, ValidationError

from wrongturn_runner.messages import LAST, Event

_T = TypeVar("_T")
FAILED: Final = 1
"""Exit status of a runner that did not finish its work."""


class ModelAtFaultError(BaseException):
    """The model cannot be driven. The message tells its owner what is wrong and what to do.

    It and the next two are no ``Exception``: the client aborts the episode of a policy that raises one, and an aborted
    episode counts. The service decides what becomes of open episodes. It closes the evaluation of a refused model, and
    drives again what a lost sandbox left open.
    """


class RunnerFailedError(BaseException):
    """Something else than the model has failed. The service starts another runner."""


class NoRoomError(RunnerFailedError):
    """All sandboxes are taken. The service starts another runner later."""


class Conversation:
    """Reads from stdin and writes to stdout until the service closes either, which ends this process at once.

    Nothing has to be put away then: the episodes are the service's, and a sandbox ends with its runner.
    """

    def __init__(self) -> None:
        """Take over stdin and stdout; what else prints to stdout goes to stderr from now on."""
        self._out = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        self._lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._status = FAILED
        self._writing = threading.Lock()
        threading.Thread(target=self._listen, daemon=True).start()

    def read(self, kind: TypeAdapter[_T]) -> _T:
        """Wait for the next message and return it. Raises RunnerFailedError if it is not of this kind."""
        try:
            return kind.validate_json(self._lines.get())
        except ValidationError as error:
            # Without the input: it holds a token.
            first = error.errors(include_url=False, include_input=False)[0]
            where = ".".join(map(str, first["loc"])) or "message"
            raise RunnerFailedError(
                f"stdin: {where}: {first['msg']}; is the runner of the service's version?"
            ) from None

    def tell(self, event: Event) -> None:
        """Write an event."""
        if isinstance(event, LAST):
            self._status = 0  # the service may close stdin as soon as it has read the event
        with self._writing:
            try:
                self._out.write(event.model_dump_json() + "\n")
                self._out.flush()
            except BrokenPipeError:
                os._exit(FAILED)

    def _listen(self) -> None:
        # Without a buffer, whose lock would keep the interpreter from ending.
        for line in open(sys.stdin.fileno(), "rb", buffering=0, closefd=False):  # noqa: SIM115
            self._lines.put(line)
        os._exit(self._status)
