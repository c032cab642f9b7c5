"""Progress of a run: rows in ``progress.csv`` and files like it, and on the screen a bar, or a line now and then."""

import csv
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Self

from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from wrongturn_agents.training.errors import TrainingError

COLUMNS: Final = (
    *("step", "minutes", "reward_mean", "episode_length", "reward_per_decision"),
    *("off_road", "collision", "wrong_way", "not_engaged", "timeout"),
    *("success_heldout", "clean_heldout", "reward_heldout", "traffic_success_heldout", "steps_per_second"),
    *("learning_rate", "divergence", "reverted", "epochs", "minibatches", "clip_fraction"),
    *("policy_loss", "value_loss", "auxiliary_loss", "explained_variance", "std_steer", "std_accelerate"),
)
"""Columns of the methods that learn by driving. Rewards are the paper's, for an episode or a decision. Verdicts are
shares of the episodes that ended.
"""
Row = dict[str, Any]
"""Figures of a row by column."""
_EVERY = 10.0
"""Seconds between two lines outside a terminal."""


class ProgressFile:
    """Rows that are on the disk as soon as they are added.

    Args:
        resumed_at: steps at which an interrupted run continues; later rows are dropped. None starts a new file.
    """

    def __init__(self, path: Path, columns: Sequence[str] = COLUMNS, *, resumed_at: int | None = None) -> None:
        self.path = path
        self._columns = columns
        remedy = "move it away, and the run goes on with a new one"
        try:
            kept = [] if resumed_at is None else [row for row in read_rows(path) if int(row["step"]) <= resumed_at]
            with path.open("w", newline="", encoding="utf-8") as file:
                writer = csv.DictWriter(file, columns, restval="", extrasaction="ignore")
                writer.writeheader()
                writer.writerows(kept)
        except OSError as error:
            raise TrainingError(f"{path}: cannot be written ({error.strerror}); {remedy}") from error
        except (ValueError, KeyError, TypeError, csv.Error) as error:
            raise TrainingError(f"{path}: is damaged; {remedy}") from error

    def add(self, row: dict[str, Any]) -> None:
        """Write a row. Missing values stay empty."""
        known = {name: _short(row[name]) for name in self._columns if row.get(name) is not None}
        with self.path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, self._columns, restval="").writerow(known)


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a file; an empty list if there is no file."""
    if not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _short(value: Any) -> Any:
    return f"{value:.6g}" if isinstance(value, float) else value


class Display:
    """Shows the rows of a run: a bar in a terminal, otherwise a line now and then."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._told_at = -_EVERY
        columns = TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()
        self._bar = Progress(*columns, disable=not sys.stdout.isatty())
        self._task = self._bar.add_task(f"{title}: begins", total=1.0)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
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
        if not self._bar.disable:
            self._bar.update(self._task, description=f"{self._title}: {text}", completed=done)
            if keep:
                self._bar.console.print(text, highlight=False)
        elif keep or time.monotonic() - self._told_at >= _EVERY:
            self._told_at = time.monotonic()
            share = "" if done is None else f"{done:.0%}, "
            print(f"{self._title}: {share}{text}", flush=True)
