"""Ends the service when the program that started it for itself is gone, however that ended."""

import os
import signal
import sys
import threading
from typing import Final

_ENDS_WITH_PARENT: Final = "WRONGTURN_ENDS_WITH_PARENT"
"""Environment variable that ``wrongturn_client.LocalService`` sets."""


def stop_with_it() -> None:
    """Stop this process as by SIGTERM at the end of stdin, if the parent asks for that.

    Stdin is then a pipe whose other end only the parent has. The system closes it even after ``kill -9``.
    """
    if os.environ.pop(_ENDS_WITH_PARENT, None):
        threading.Thread(target=_wait, args=(sys.stdin.fileno(),), name="parent", daemon=True).start()


def _wait(pipe: int) -> None:
    while os.read(pipe, 1):
        pass
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for closed in (1, 2):  # nobody reads them any more, and writing to them would fail
        os.dup2(nowhere, closed)
    os.kill(os.getpid(), signal.SIGTERM)
