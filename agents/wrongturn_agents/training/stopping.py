"""Ctrl-C ends a run in good order: it saves first, so that ``--resume`` loses nothing."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

_NOTE: Final = "This run ends as soon as it has saved. Press Ctrl-C again to end it at once."


class Stop:
    """Whether someone asked a run to end, by Ctrl-C (SIGINT) or by SIGTERM.

    Attributes:
        asked: whether the run must save and end.
        armed: whether the run has anything to save yet. Until then, Ctrl-C ends it at once.
    """

    def __init__(self) -> None:
        self.asked = self.armed = False

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Hear the signals while the block runs. Only a program's main thread can; elsewhere nothing changes."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def hear(_number: int, _frame: Any) -> None:
            if self.asked or not self.armed:
                raise KeyboardInterrupt
            self.asked = True
            print(_NOTE, file=sys.stderr, flush=True)

        before = {number: signal.signal(number, hear) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def saved(self) -> None:
        """End the run, now that it has saved, if someone asked for that."""
        if self.asked:
            raise KeyboardInterrupt
