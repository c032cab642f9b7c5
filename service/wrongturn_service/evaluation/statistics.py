"""The intervals and tests of the leaderboard.

scipy and statsmodels are imported where they are used: together they cost seconds, and a service that starts need
not wait for them.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Final

LEVEL: Final = 0.05
"""Of every test; intervals are at 1 - LEVEL."""
RESAMPLES: Final = 9_999
"""Of the bootstrap."""
BOOTSTRAP_SEED: Final = 20_210_711
"""Fixed, so that the same outcomes give the same interval wherever they are counted."""


@lru_cache(maxsize=4096)
def wilson(count: int, trials: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a rate, ``count`` of ``trials``; it holds the rate itself.

    Raises:
        ValueError: ``count`` does not lie in 0 to ``trials``, or there are no trials.
    """
    if trials < 1 or not 0 <= count <= trials:
        raise ValueError(f"count: {count} of {trials} is no rate; give 0 <= count <= trials with one trial at least")
    from statsmodels.stats.proportion import proportion_confint  # noqa: PLC0415

    low, high = proportion_confint(count, trials, alpha=LEVEL, method="wilson")
    # At 0 and at all of them the formula meets the rate, and rounding can put it an ulp to the wrong side.
    rate = count / trials
    return max(0.0, min(float(low), rate)), min(1.0, max(float(high), rate))


@lru_cache(maxsize=4096)
def mcnemar_two_sided(only_first: int, only_second: int) -> float:
    """Exact McNemar: how likely discordant pairs split at least as unevenly by chance, either way.

    Args:
        only_first: pairs in which the first of the two was unsafe and the second not.
        only_second: the other way round.
    """
    from statsmodels.stats.contingency_tables import mcnemar  # noqa: PLC0415

    # Concordant pairs have no part in the exact test, so the diagonal may stay empty.
    return float(mcnemar([[0, only_first], [only_second, 0]], exact=True).pvalue)


@lru_cache(maxsize=4096)
def mcnemar_one_sided(only_worse: int, only_better: int) -> float:
    """Exact McNemar against the alternative that the second of the two is the safer.

    Args:
        only_worse: pairs in which only the first was unsafe.
        only_better: pairs in which only the second was unsafe.

    Returns:
        The p-value; 1 where no pair is discordant.
    """
    discordant = only_worse + only_better
    if discordant == 0:
        return 1.0
    from scipy.stats import binomtest  # noqa: PLC0415

    return float(binomtest(only_worse, discordant, 0.5, alternative="greater").pvalue)


def holm_rejections(p_values: Sequence[float]) -> tuple[bool, ...]:
    """Which hypotheses Holm's step-down procedure rejects at :data:`LEVEL`, in the order given."""
    # No family has a rejection where none would be rejected alone; it is the common case of a long leaderboard.
    if not p_values or min(p_values) > LEVEL:
        return (False,) * len(p_values)
    from statsmodels.stats.multitest import multipletests  # noqa: PLC0415

    rejected = multipletests(p_values, alpha=LEVEL, method="holm")[0]
    return tuple(bool(one) for one in rejected)


def cluster_bootstrap(differences: Mapping[tuple[str, str], Sequence[int]]) -> tuple[float, float]:
    """Percentile interval at 95 % of a mean, whole clusters being drawn anew.

    Trials at one junction share its geometry and what stands behind it, so that they are no independent draws; the
    junctions are.

    Args:
        differences: per cluster, the paired differences (-1, 0 or 1) of its trials. Clusters are taken in the order
            of their names, so that the order of the trials changes nothing.

    Returns:
        The interval; it holds the mean itself, and is ``(mean, mean)`` for a single cluster or equal ones.

    Raises:
        ValueError: no cluster has a trial.
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
    # Few and uneven clusters can put a percentile, like rounding, past the mean: the interval is widened to hold it.
    low, high = np.quantile((draws @ sums) / (draws @ sizes), (LEVEL / 2, 1 - LEVEL / 2))
    return min(float(low), mean), max(float(high), mean)
