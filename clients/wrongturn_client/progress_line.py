"""One line that shows how far an evaluation is, on a terminal and in a notebook."""

import sys
from typing import Final

_WIDTH: Final = 30
"""Characters of the bar."""


class ProgressLine:
    """Writes a bar to stderr; each call writes over it.

    Args:
        name: What is under way.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __call__(self, finished: int, total: int) -> None:
        """Show how many of all episodes are finished."""
        full = _WIDTH * finished // max(total, 1)
        bar = "#" * full + "." * (_WIDTH - full)
        # A carriage return is all that both terminals and notebooks understand.
        print(
            f"\r{self._name}: [{bar}] {finished} of {total} episodes",
            end="\n" if finished >= total else "",
            file=sys.stderr,
            flush=True,
        )
