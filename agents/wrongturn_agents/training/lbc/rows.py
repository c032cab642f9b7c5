"""Rows of a run's ``privileged.csv`` and ``progress.csv``."""

import csv
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

COLUMNS: Final = (
    "step",
    "minutes",
    "loss",
    "collected",
    "round",
    "off_road",
    "collision",
    "wrong_way",
    "not_engaged",
    "timeout",
    "success_heldout",
    "clean_heldout",
    "reward_heldout",
    "traffic_success_heldout",
    "steps_per_second",
    "learning_rate",
)
"""Steps are samples that were learned from. The loss is in metres or, in ``progress.csv``, in pixels. Verdicts are
shares of the drives that ended while samples were collected; a drive that did not fail ended by its ``timeout``."""
VERDICTS: Final = ("off_road", "collision", "wrong_way", "not_engaged", "timeout")


class Rows:
    """Rows that are on the disk as soon as they are added.

    Args:
        path: the file.
        resumed_at: step at which an interrupted run continues; later rows are dropped. None starts a new file.
    """

    def __init__(self, path: Path, *, resumed_at: int | None = None) -> None:
        self._path = path
        kept: list[dict[str, str]] = []
        if resumed_at is not None and path.is_file():
            with path.open(newline="", encoding="utf-8") as file:
                kept = [row for row in csv.DictReader(file) if int(row["step"]) <= resumed_at]
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, COLUMNS, restval="")
            writer.writeheader()
            writer.writerows(kept)

    def add(self, row: dict[str, Any]) -> None:
        """Write a row. Missing values stay empty."""
        known = {name: row[name] for name in COLUMNS if row.get(name) is not None}
        shown = {name: f"{value:.6g}" if isinstance(value, float) else value for name, value in known.items()}
        with self._path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, COLUMNS, restval="").writerow(shown)


def shares(verdicts: Sequence[str]) -> dict[str, float | None]:
    """Return the share of each verdict; None if there are none."""
    counts = Counter(verdicts)
    return {name: counts[name] / len(verdicts) if verdicts else None for name in VERDICTS}
