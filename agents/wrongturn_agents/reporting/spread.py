"""Counts in words: Wilson's interval for one agent, median and range for an algorithm over its seeds."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from statistics import median
from typing import Self

from wrongturn_agents.reporting.errors import MissingPackageError

_LEVEL = 0.95


@lru_cache(maxsize=4096)
def wilson(count: int, trials: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a rate.

    Raises:
        MissingPackageError: scipy is not installed.
    """
    try:
        from scipy.stats import binomtest  # noqa: PLC0415 - takes a second to import
    except ImportError as error:
        raise MissingPackageError("scipy is not installed; install wrongturn-agents[training]") from error
    interval = binomtest(count, trials).proportion_ci(_LEVEL, method="wilson")
    return float(interval.low), float(interval.high)


def with_interval(count: int, trials: int, *, percent: bool = False) -> str:
    """A count, or its rate in percent, with Wilson's interval of the rate in percent."""
    low, high = wilson(count, trials)
    shown = f"{100 * count / trials:.0f}" if percent else str(count)
    return f"{shown} ({100 * low:.0f}–{100 * high:.0f}{'' if percent else ' %'})"


@dataclass(frozen=True)
class Spread:
    """How a figure moves from one seed to the next."""

    median: float
    least: float
    most: float
    seeds: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Self:
        """Of one value a seed, one at least."""
        return cls(float(median(values)), float(min(values)), float(max(values)), len(values))

    def __str__(self) -> str:
        return f"{self.median:g} [{self.least:g}–{self.most:g}]"
