"""Tests of the leaderboard, and the interval of a difference.

``wrongturn_protocol.intervals`` has the interval of a rate: tables that are made without a service show it too.
Functions import scipy and numpy when they run: the import takes a second, and the service starts without it.
"""

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from wrongturn_protocol.intervals import LEVEL, Marks, interval

if TYPE_CHECKING:
    from numpy.typing import NDArray


@lru_cache(maxsize=4096)
def mcnemar_two_sided(only_first: int, only_second: int) -> float:
    """Return the two-sided p-value of McNemar's exact test.

    The arguments are the pairs in which only the one was unsafe. If neither is safer, each such pair is a throw of a
    fair coin: a binomial test.
    """
    from scipy.stats import binomtest  # noqa: PLC0415

    differing = only_first + only_second
    return float(binomtest(only_first, differing).pvalue) if differing else 1.0


def difference_interval(first: Marks, second: Marks, level: float = LEVEL) -> tuple[float, float]:
    """Return the interval of the first rate minus the second, 95 % by default. It contains the difference.

    The deviations of both intervals are added in quadrature (R. Newcombe 1998; G. Zou and A. Donner 2008). A trial and
    its twin drive the same approach, so their rates rise and fall together: the interval is rather too wide.
    """
    (rate_a, low_a, high_a), (rate_b, low_b, high_b) = ((_rate(one), *interval(one, level)) for one in (first, second))
    difference = rate_a - rate_b
    below, above = math.hypot(rate_a - low_a, high_b - rate_b), math.hypot(high_a - rate_a, rate_b - low_b)
    return max(-1.0, difference - below), min(1.0, difference + above)


def _rate(marks: Marks) -> float:
    cells = [cell for places in marks.values() for cell in places.values()]
    return sum(count for count, _ in cells) / sum(trials for _, trials in cells)


Units = tuple[Sequence[int], Sequence[int]]
"""Counts of unsafe trials in the units of a stratum, of both agents. A unit is a trial, or a town."""


def exact_test(strata: Iterable[Units]) -> float:
    """Return the two-sided p-value of an exact test for a difference of two agents within strata.

    If the agents are alike, each way to deal a stratum's units to them is as likely as any other. The distribution of
    the first agent's sum over strata is the convolution. The p-value adds the probabilities of all sums that are no
    likelier than the one seen. Of trials in one stratum this is Fisher's exact test, in several the exact form of
    Mantel and Haenszel's, in pairs McNemar's. Raises ValueError for a negative count.
    """
    import numpy as np  # noqa: PLC0415

    chances = np.ones(1)
    seen = 0
    for first, second in strata:
        pooled = tuple(sorted((*first, *second)))
        if pooled and pooled[0] < 0:
            raise ValueError(f"strata: {pooled[0]} is no count")
        if first and second and pooled[0] != pooled[-1]:  # otherwise every deal gives the same sum
            chances = np.convolve(chances, _dealt(pooled, len(first)))
            seen += sum(first)
    # Equal probabilities differ by rounding; scipy's Fisher test allows for the same.
    return min(1.0, float(chances[chances <= chances[seen] * (1 + 1e-7)].sum()))


@lru_cache(maxsize=4096)
def _dealt(pooled: tuple[int, ...], hand: int) -> "NDArray[Any]":
    """Return the probability of each sum, from 0 on, of so many units dealt from all."""
    import numpy as np  # noqa: PLC0415

    ways = np.zeros((hand + 1, sum(pooled) + 1))
    ways[0, 0] = 1.0
    for number, value in enumerate(pooled, 1):
        ways[1:, value:] += ways[:-1, : ways.shape[1] - value].copy()
        if number % 200 == 0:  # a factor cancels below, and keeps the numbers finite
            ways /= ways.max()
    chances: NDArray[Any] = ways[hand] / ways[hand].sum()
    return chances
