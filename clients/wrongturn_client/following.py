"""Follow a submission to its end, with one progress line on a terminal and plain lines elsewhere."""

import contextlib
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from typing import Final

from rich.console import Console
from rich.filesize import decimal
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from wrongturn_client.client import Client
from wrongturn_client.evaluation import Evaluation
from wrongturn_protocol import EvaluationState, SubmissionDetail, SubmissionState
from wrongturn_protocol.submissions import SubmissionLogLine

_PAUSE: Final = 1.0
"""Seconds between two looks at a submission."""
_LINE_EVERY: Final = 10.0
"""Seconds between two plain lines about the same state."""


class Display:
    """Shows how far a submission is.

    With bars, on a terminal: one line with a bar, and the log above it. Else a line for each new state, and every ten
    seconds while one lasts.
    """

    def __init__(
        self, name: str, console: Console, bars: Progress | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._name, self._console, self._bars, self._clock = name, console, bars, clock
        self._bar = None if bars is None else bars.add_task(name, total=None)
        self._state: object = None
        self._said = ""
        self._next = 0.0

    def uploaded(self, sent: int, total: int) -> None:
        """Show how many bytes of the model are sent; without a bar, once all are."""
        if self._bars is not None:
            self.show("upload", f"{decimal(sent)} of {decimal(total)} sent", sent, total)
        elif sent >= total:
            self.show("upload", f"{decimal(total)} sent", sent, total)

    def at(self, detail: SubmissionDetail) -> None:
        """Show where the submission is; the bar is that of the episodes."""
        self.show(detail.state, whereabouts(detail), detail.finished or 0, detail.episodes)

    def news(self, line: SubmissionLogLine) -> None:
        """Show a new line of the log with its time of day here."""
        self._print(f"{datetime.fromisoformat(line.time).astimezone():%H:%M:%S} {line.message}")

    def show(self, state: object, text: str, done: int, total: int | None) -> None:
        """Show a text, and how much is done."""
        if self._bars is not None and self._bar is not None:
            if self._bars.tasks[0].total != total:  # another bar, whose time begins now
                self._bars.reset(self._bar, total=total)
            self._bars.update(self._bar, description=f"{self._name}: {text}", completed=done)
        elif text != self._said and (state != self._state or self._clock() >= self._next):
            self._state, self._said, self._next = state, text, self._clock() + _LINE_EVERY
            self._print(f"{self._name}: {text}")

    def _print(self, text: str) -> None:
        self._console.print(text, markup=False, soft_wrap=True)


def follow(client: Client, submission: str, display: Display) -> SubmissionDetail:
    """Follow a submission until it is over, and return it."""
    seen = 0
    while True:
        detail = client.submission(submission)
        # Read after the state, so that the last state's log is complete.
        log = client.submission_log(submission)
        for line in log[seen:]:
            display.news(line)
        seen = len(log)
        display.at(detail)
        if detail.state.over:
            return detail
        time.sleep(_PAUSE)


def watch(client: Client, evaluation: str) -> Evaluation:
    """Show how far an evaluation is until it is over, and return it."""
    detail = client.evaluation(evaluation)
    with display_of(f"{client.agent(detail.agent).name} on {detail.suite}") as display:
        while True:
            display.show(detail.state, f"{detail.finished} of {detail.trials} episodes", detail.finished, detail.trials)
            if detail.state is not EvaluationState.RUNNING:
                return detail
            time.sleep(_PAUSE)
            detail = client.evaluation(evaluation)


def whereabouts(detail: SubmissionDetail) -> str:
    """Return in a few words where a submission is."""
    match detail.state:
        case SubmissionState.QUEUED:
            return "waits for its check"
        case SubmissionState.CHECKED:
            ahead = {None: "waits for its turn", 0: "is the next"}.get(detail.position, f"{detail.position} before it")
            return f"checked, {ahead}"
        case SubmissionState.RUNNING if detail.episodes:
            return f"{detail.finished or 0} of {detail.episodes} episodes"
        case _:
            return detail.state.value


def bars_on(console: Console) -> Progress:
    """Return the bar of a :class:`Display` on a terminal."""
    text, left = TextColumn("{task.description}", markup=False), TextColumn("left:")
    return Progress(text, BarColumn(), TimeElapsedColumn(), left, TimeRemainingColumn(), console=console)


@contextmanager
def display_of(name: str) -> Iterator[Display]:
    """Show the progress of an agent of this name on stderr while the ``with`` block runs."""
    console = Console(stderr=True, highlight=False)
    with contextlib.nullcontext() if not console.is_terminal else bars_on(console) as bars:
        yield Display(name, console, bars)
