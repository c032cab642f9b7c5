"""Ways to show how far a run is: a bar, lines, or JSON lines for a program."""

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from typing import IO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bars

Progress = Callable[[int, int], None]
"""Function that is called with the numbers of finished and of all episodes."""


class ProgressStyle(StrEnum):
    """Ways to show progress."""

    AUTO = "auto"
    """A bar on a terminal, else lines."""
    BAR = "bar"
    LINES = "lines"
    JSON = "json"


def progress_bars(console: Console) -> Bars:
    """Return bars with the agent's name, the count of episodes, the rate and the time left."""
    return Bars(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("episodes"),
        TextColumn("{task.fields[rate]}", style="progress.data.speed"),
        TimeRemainingColumn(compact=True),
        console=console,
    )


def add_bar(bars: Bars, name: str) -> Progress:
    """Add a bar for an agent, and return the function that moves it."""
    bar = bars.add_task(name, total=None, rate="")

    def move(finished: int, total: int) -> None:
        bars.update(bar, completed=finished, total=total)
        speed = next(task.speed for task in bars.tasks if task.id == bar)
        bars.update(bar, rate="" if speed is None else f"{_rate(60 * speed)}/min")

    return move


def lines_progress(name: str, stream: IO[str], clock: Callable[[], float] = time.monotonic) -> Progress:
    """Return a function that writes a line at its first call and the last, and every ten seconds between them."""
    began: tuple[float, int] | None = None
    next_line = 0.0

    def write(finished: int, total: int) -> None:
        nonlocal began, next_line
        now = clock()
        began = began or (now, finished)
        if now < next_line and finished < total:
            return
        next_line = now + 10.0
        took, since = now - began[0], finished - began[1]
        rate = f", {_rate(60 * since / took)} a minute" if took > 1.0 else ""
        print(f"{name}: {finished} of {total} episodes{rate}", file=stream, flush=True)

    return write


@contextmanager
def show_progress(style: ProgressStyle, name: str) -> Iterator[Progress]:
    """Show an agent's progress on stderr while the ``with`` block runs.

    A line of JSON is ``{"agent": …, "finished": …, "total": …}``.
    """
    console = Console(stderr=True)
    if style is ProgressStyle.JSON:
        yield lambda finished, total: print(
            json.dumps({"agent": name, "finished": finished, "total": total}), file=sys.stderr, flush=True
        )
    elif style is ProgressStyle.BAR or (style is ProgressStyle.AUTO and console.is_terminal):
        with progress_bars(console) as bars:
            yield add_bar(bars, name)
    else:
        yield lines_progress(name, sys.stderr)


def _rate(rate: float) -> str:
    """Return a rate, with one decimal if it is small: journeys take minutes."""
    return f"{rate:.0f}" if rate >= 10 else f"{rate:.1f}"
