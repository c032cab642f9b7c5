"""Progress of a run on the screen: a bar in a terminal, otherwise a line now and then."""

import sys
import time
from types import TracebackType
from typing import Any, Self

from wrongturn_agents.training.progress_file import Row

_EVERY = 10.0
"""Seconds between two lines outside a terminal."""


class Display:
    """Shows the rows of a run."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._told_at = -_EVERY
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> Self:
        if sys.stdout.isatty():
            # Imported here, because machines without a terminal may not have it.
            from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn  # noqa: PLC0415

            columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
            self._bar = Progress(*columns)
            self._task = self._bar.add_task(f"{self._title}: begins", total=1.0)
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def row(self, row: Row) -> None:
        """Show a row of progress; ``done`` is the share of the run that is over, ``unit`` what its steps are."""
        text = f"{row['minutes']:.1f} min, {row['step']:,} {row['unit']}, {row['steps_per_second']:,.0f}/s"
        if (reward := row.get("reward_mean")) is not None:
            text += f", reward of an episode {reward:,.0f}"
        elif (loss := row.get("loss")) is not None:
            text += f", loss {loss:.3f}"
        held_out = row.get("success_heldout")
        if held_out is not None:
            text += f", held-out journeys {held_out:.0%}"
        if (beside := row.get("traffic_success_heldout")) is not None:
            text += f", with traffic {beside:.0%}"
        part = row.get("part")
        self._tell(f"{part}: {text}" if part else text, row["done"], keep=held_out is not None)

    def note(self, text: str) -> None:
        """Show what happens between rows, such as how far a pretraining is."""
        self._tell(text, None, keep=False)

    def _tell(self, text: str, done: float | None, *, keep: bool) -> None:
        if self._bar is not None:
            self._bar.update(self._task, description=f"{self._title}: {text}", completed=done)
            if keep:
                self._bar.console.print(text, highlight=False)
        elif keep or time.monotonic() - self._told_at >= _EVERY:
            self._told_at = time.monotonic()
            print(f"{self._title}: {text}", flush=True)
