"""Rows of a run's ``privileged.csv`` and ``progress.csv``."""

from collections import Counter
from collections.abc import Sequence
from typing import Final

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


def shares(verdicts: Sequence[str]) -> dict[str, float | None]:
    """Return the share of each verdict; None if there are none."""
    counts = Counter(verdicts)
    return {name: counts[name] / len(verdicts) if verdicts else None for name in VERDICTS}
