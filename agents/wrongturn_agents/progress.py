"""How a run tells how far it is."""

import json
import sys
import time
from types import TracebackType
from typing import IO, Protocol, Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from wrongturn_agents.progress_style import ProgressStyle


class Report(Protocol):
    """Is told how far a run is; used in a ``with`` block."""

    def __enter__(self) -> Self:
        """Begin to show."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Stop showing."""

    def __call__(self, finished: int, total: int) -> None:
        """So many of so many episodes are finished."""


def _rate(rate: float) -> str:
    """A rate with its tenths where it is small: journeys take minutes."""
    return f"{rate:.0f}" if rate >= 10 else f"{rate:.1f}"


class RateColumn(ProgressColumn):
    """Episodes a minute."""

    def render(self, task: Task) -> Text:
        """The rate as rich estimates it."""
        return Text("" if task.speed is None else f"{_rate(60 * task.speed)}/min", style="progress.data.speed")


def progress_bar(console: Console) -> Progress:
    """A bar with the agent's name, the count of episodes, the rate and the time left."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("episodes"),
        RateColumn(),
        TimeRemainingColumn(compact=True),
        console=console,
    )


class BarReport:
    """A bar on a terminal."""

    def __init__(self, name: str, console: Console) -> None:
        self._bar = progress_bar(console)
        self._task = self._bar.add_task(name, total=None)

    def __enter__(self) -> Self:
        """Draw it."""
        self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Leave it as it is."""
        self._bar.stop()

    def __call__(self, finished: int, total: int) -> None:
        """Move it."""
        self._bar.update(self._task, completed=finished, total=total)


class LinesReport:
    """A line now and then, where there is no terminal."""

    def __init__(self, name: str, stream: IO[str], every: float = 10.0) -> None:
        """Describe it.

        Args:
            name: the agent's.
            stream: gets the lines.
            every: seconds between two lines at least; the first and the last come in any case.
        """
        self._name, self._stream, self._every = name, stream, every
        self._began: float | None = None
        self._told = 0.0
        self._first = 0

    def __enter__(self) -> Self:
        """Nothing to begin."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Nothing to end."""

    def __call__(self, finished: int, total: int) -> None:
        """Write a line, if it is time for one."""
        now = time.monotonic()
        if self._began is None:
            self._began, self._first = now, finished
        elif now - self._told < self._every and finished < total:
            return
        self._told = now
        took = now - self._began
        rate = f", {_rate(60 * (finished - self._first) / took)} a minute" if took > 1.0 else ""
        print(f"{self._name}: {finished} of {total} episodes{rate}", file=self._stream, flush=True)


class JsonReport(LinesReport):
    """An object a line, for a program that watches."""

    def __call__(self, finished: int, total: int) -> None:
        """Write ``{"agent": …, "finished": …, "total": …}``."""
        line = json.dumps({"agent": self._name, "finished": finished, "total": total})
        print(line, file=self._stream, flush=True)


def report(style: ProgressStyle, name: str) -> Report:
    """The report of a style, on stderr; ``auto`` draws a bar where that is a terminal."""
    console = Console(stderr=True)
    if style is ProgressStyle.JSON:
        return JsonReport(name, sys.stderr)
    if style is ProgressStyle.BAR or (style is ProgressStyle.AUTO and console.is_terminal):
        return BarReport(name, console)
    return LinesReport(name, sys.stderr)
