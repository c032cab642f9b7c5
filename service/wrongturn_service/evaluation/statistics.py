"""Intervals and tests of the leaderboard.

Functions import scipy and statsmodels when they run: the imports take seconds, and the service starts without them.
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

    Raises:
        ValueError: There are no trials, or ``count`` is not in 0 to ``trials``.
    """
    if trials < 1 or not 0 <= count <= trials:
        raise ValueError(f"count: {count} of {trials} is no rate; give 0 <= count <= trials with one trial at least")
    from statsmodels.stats.proportion import proportion_confint  # noqa: PLC0415

    low, high = proportion_confint(count, trials, alpha=level, method="wilson")
    # At a rate of 0 or 1 the bound equals the rate; rounding can put it an ulp beyond.
    rate = count / trials
    return max(0.0, min(float(low), rate)), min(1.0, max(float(high), rate))


@lru_cache(maxsize=4096)
def mcnemar_two_sided(only_first: int, only_second: int) -> float:
    """Return the two-sided p-value of McNemar's exact test.

    Args:
        only_first: Pairs in which only the first was unsafe.
        only_second: Pairs in which only the second was unsafe.
    """
    from statsmodels.stats.contingency_tables import mcnemar  # noqa: PLC0415

    # The exact test does not use concordant pairs, so the diagonal may be empty.
    return float(mcnemar([[0, only_first], [only_second, 0]], exact=True).pvalue)


@lru_cache(maxsize=4096)
def mcnemar_one_sided(only_worse: int, only_better: int) -> float:
    """Return the one-sided p-value of McNemar's exact test. The alternative: the second is safer.

    Args:
        only_worse: Pairs in which only the first was unsafe.
        only_better: Pairs in which only the second was unsafe.

    Returns:
        The p-value, 1 if no pair is discordant.
    """
    discordant = only_worse + only_better
    if discordant == 0:
        return 1.0
    from scipy.stats import binomtest  # noqa: PLC0415

    return float(binomtest(only_worse, discordant, 0.5, alternative="greater").pvalue)


def holm_rejections(p_values: Sequence[float]) -> tuple[bool, ...]:
    """Return which hypotheses Holm's step-down procedure rejects at :data:`LEVEL`, in the order given.

    The procedure takes the p-values from the smallest one on and compares each with the level divided by the number
    of those left (S. Holm, "A simple sequentially rejective multiple test procedure", 1979). It is written out here
    because statsmodels' own runs the garbage collector at each call.
    """
    rejected = [False] * len(p_values)
    for step, index in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        if p_values[index] > LEVEL / (len(p_values) - step):
            break
        rejected[index] = True
    return tuple(rejected)


def cluster_bootstrap(differences: Mapping[tuple[str, str], Sequence[int]]) -> tuple[float, float]:
    """Return the 95 % percentile interval of a mean, by a bootstrap over whole clusters.

    Trials at one junction share its geometry and scenery, so they are not independent. Junctions are.

    Args:
        differences: Paired differences (-1, 0 or 1) of the trials of each cluster. Clusters are sorted by name, so
            the order of the trials does not change the result.

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
