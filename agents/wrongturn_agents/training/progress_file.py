"""``progress.csv`` and files like it: one row for each update of a run."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from wrongturn_agents.training.errors import TrainingError

COLUMNS: Final = (
    *("step", "minutes", "reward_mean", "episode_length", "reward_per_decision"),
    *("off_road", "collision", "wrong_way", "not_engaged", "timeout"),
    *("success_heldout", "clean_heldout", "reward_heldout", "traffic_success_heldout", "steps_per_second"),
    *(f"seconds_{part}" for part in ("env", "render", "encode", "policy", "buffer", "learn", "evaluate", "rest")),
    *("learning_rate", "divergence", "reverted", "epochs", "minibatches", "clip_fraction"),
    *("policy_loss", "value_loss", "auxiliary_loss", "explained_variance", "std_steer", "std_accelerate"),
)
"""Columns of the methods that learn by driving. Rewards are the paper's, for an episode or a decision. Verdicts are
shares of the episodes that ended. Seconds are those of the row.
"""
Row = dict[str, Any]
"""Figures of a row by column."""


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
                writer = csv.DictWriter(file, columns, restval="")
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
