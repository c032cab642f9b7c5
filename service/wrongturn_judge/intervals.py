"""Intervals and tests of the leaderboard.

Functions import scipy when they run: the import takes a second, and the service starts without it.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Final

LEVEL: Final = 0.05
"""Significance level of every test. Intervals have the level 1 - LEVEL."""
RANK_LEVEL: Final = 0.166
"""One minus the level of the intervals that decide ranks. Two 83.4 % intervals that do not touch differ at about 5 %
(H. Goldstein and M. Healy, "The graphical presentation of a collection of means", 1995)."""
RESAMPLES: Final = 9_999
"""Resamples of the bootstrap."""
BOOTSTRAP_SEED: Final = 20_210_711
"""Fixed seed, so that the same outcomes always give the same interval."""


@lru_cache(maxsize=4096)
def wilson(count: int, trials: int, level: float = LEVEL) -> tuple[float, float]:
    """Return Wilson's interval of the rate ``count / trials``, 95 % by default. It contains the rate.

    Raises ValueError if there are no trials, or ``count`` is not in 0 to ``trials``.
    """
    if trials < 1 or not 0 <= count <= trials:
        raise ValueError(f"count: {count} of {trials} is no rate; give 0 <= count <= trials with one trial at least")
    from scipy.stats import binomtest  # noqa: PLC0415

    low, high = binomtest(count, trials).proportion_ci(1 - level, method="wilson")
    # At a rate of 0 or 1 the bound equals the rate; rounding can put it an ulp beyond.
    rate = count / trials
    return max(0.0, min(float(low), rate)), min(1.0, max(float(high), rate))


@lru_cache(maxsize=4096)
def mcnemar_two_sided(only_first: int, only_second: int) -> float:
    """Return the two-sided p-value of McNemar's exact test.

    The arguments are the pairs in which only the one was unsafe. If neither is safer, each such pair is a throw of a
    fair coin: a binomial test.
    """
    from scipy.stats import binomtest  # noqa: PLC0415

    differing = only_first + only_second
    return float(binomtest(only_first, differing).pvalue) if differing else 1.0


def stratified_exact(strata: Sequence[tuple[int, int, int, int]]) -> float:
    """Return the two-sided p-value of an exact test for a difference of two rates within strata.

    Given each stratum's total, the first count is hypergeometric if the rates are equal. The distribution of the sum
    over strata is the convolution. The p-value adds the probabilities of all sums that are no likelier than the one
    seen. For one stratum this is Fisher's exact test; for several, the exact form of Mantel and Haenszel's. A stratum
    has first count, first trials, second count, second trials. Raises ValueError for a count that is not in 0 to its
    trials.
    """
    import numpy as np  # noqa: PLC0415
    from scipy.stats import hypergeom  # noqa: PLC0415

    chances = np.ones(1)
    seen = 0
    for count_a, trials_a, count_b, trials_b in strata:
        if not (0 <= count_a <= trials_a and 0 <= count_b <= trials_b):
            raise ValueError(f"strata: {count_a} of {trials_a} against {count_b} of {trials_b} are no counts")
        total = count_a + count_b
        least = max(0, total - trials_b)
        values = np.arange(least, min(total, trials_a) + 1)
        chances = np.convolve(chances, hypergeom.pmf(values, trials_a + trials_b, total, trials_a))
        seen += count_a - least
    # Equal probabilities differ by rounding; scipy's Fisher test allows for the same.
    return min(1.0, float(chances[chances <= chances[seen] * (1 + 1e-7)].sum()))


def cluster_bootstrap(differences: Mapping[tuple[str, str], Sequence[int]]) -> tuple[float, float]:
    """Return the 95 % percentile interval of a mean, by a bootstrap over whole clusters.

    Trials at one junction share its geometry and scenery, so they are not independent. Junctions are. A cluster has the
    paired differences (-1, 0 or 1) of its trials. The order of clusters and trials does not change the result.

    Returns:
        The interval. It contains the mean, and is ``(mean, mean)`` for a single cluster or equal clusters.

    Raises:
        ValueError: No cluster has a trial.
    """
    import numpy as np  # noqa: PLC0415

    names = sorted(name for name in differences if len(differences[name]))
    if not names:
        raise ValueError("differences: no cluster has a trial; give at least one")
    sums = np.array([sum(differences[name]) for name in names], dtype=np.float64)
    sizes = np.array([len(differences[name]) for name in names], dtype=np.float64)
    mean = float(sums.sum() / sizes.sum())
    generator = np.random.default_rng(BOOTSTRAP_SEED)
    draws = generator.multinomial(len(names), np.full(len(names), 1 / len(names)), size=RESAMPLES)
    # Few or uneven clusters can put a percentile beyond the mean, so the interval is widened.
    low, high = np.quantile((draws @ sums) / (draws @ sizes), (LEVEL / 2, 1 - LEVEL / 2))
    return min(float(low), mean), max(float(high), mean)
