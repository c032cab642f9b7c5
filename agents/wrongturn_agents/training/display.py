"""Progress of a run on the screen: a bar in a terminal, otherwise a line now and then."""

import sys
import time
from types import TracebackType
from typing import Any, Self

_EVERY = 10.0
"""Seconds between two lines outside a terminal."""


class Display:
    """Shows the rows of a run.

    Args:
        title: name of the run.
    """

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

    def row(self, row: dict[str, Any]) -> None:
        """Show a row of ``progress.csv`` and its ``done``, the share of the run that is over."""
        reward = row["reward_mean"]
        text = (
            f"{row['minutes']:.1f} min, {row['step']:,} steps, {row['steps_per_second']:,.0f}/s, reward of an episode "
            + ("-" if reward is None else f"{reward:,.0f}")
        )
        held_out = row.get("success_heldout")
        if held_out is not None:
            text += f", held-out journeys {held_out:.0%}"
            if (beside := row.get("traffic_success_heldout")) is not None:
                text += f", with traffic {beside:.0%}"
        self._tell(text, row.get("done"), keep=held_out is not None)

    def pretraining(self, frames: int, loss: float) -> None:
        """Show how far the encoder's pretraining is."""
        self._tell(f"pretraining, {frames:,} frames, loss {loss:.3f}", None, keep=False)

    def pictures(self, number: int, exits: float, distance: float) -> None:
        """Show how far a training of ``doubting`` is, with its losses."""
        self._tell(f"{number:,} pictures, losses {exits:.3f} (exits) and {distance:.3f} (distance)", None, keep=False)

    def samples(self, half: str, row: dict[str, Any]) -> None:
        """Show a row of a training of ``lbc``, whose halves are ``lbc-privileged`` and ``lbc``."""
        text = f"{half}: {row['minutes']:.1f} min, {row['step']:,} samples, {row['steps_per_second']:,.0f}/s"
        text += f", loss {row['loss']:.3f}"
        if (held_out := row.get("success_heldout")) is not None:
            text += f", held-out journeys {held_out:.0%}"
        if (beside := row.get("traffic_success_heldout")) is not None:
            text += f", with traffic {beside:.0%}"
        self._tell(text, row["done"], keep=held_out is not None)

    def _tell(self, text: str, done: float | None, *, keep: bool) -> None:
        if self._bar is not None:
            self._bar.update(self._task, description=f"{self._title}: {text}", completed=done)
            if keep:
                self._bar.console.print(text, highlight=False)
        elif keep or time.monotonic() - self._told_at >= _EVERY:
            self._told_at = time.monotonic()
            print(f"{self._title}: {text}", flush=True)
