"""One line on stderr when a program waits for compilation, which takes minutes on a new machine."""

import functools
import sys
import threading
from typing import Any, Final

from numba.core import event

_SECONDS: Final = 1.5
"""How long the compilation of one kernel lasts before it is worth a line."""
_LINE: Final = "wrongturn: compiling the simulation for this machine; it takes a minute or two, and only once\n"


class _Notice(event.Listener):
    """Prints the line once, when a compilation lasts; kernels that are in the cache are only loaded."""

    def __init__(self) -> None:
        self._depth = 0
        self._said = threading.Event()
        self._timer: threading.Timer | None = None

    def on_start(self, event: Any) -> None:  # noqa: ARG002
        """Wait for a while. Kernels that a kernel calls are compiled within it."""
        self._depth += 1
        if self._depth == 1 and not self._said.is_set():
            self._timer = threading.Timer(_SECONDS, self._say)
            self._timer.daemon = True
            self._timer.start()

    def on_end(self, event: Any) -> None:  # noqa: ARG002
        """Stop waiting."""
        self._depth -= 1
        if self._depth == 0 and self._timer is not None:
            self._timer.cancel()

    def _say(self) -> None:
        self._said.set()
        sys.stderr.write(_LINE)
        sys.stderr.flush()


@functools.cache
def announce_compilation() -> None:
    """Print a line on stderr if this process has to compile for long. Safe to call more than once."""
    event.register("numba:compile", _Notice())  # type: ignore[no-untyped-call]
