"""Whether the paper's order of its agents holds over training seeds, in its own column.

The test is of the three agents that the paper's authors trained, 35 > 16 > 3 unsafe. They differ in one thing each.
The other two were trained by others, and stand beside them.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from statistics import median
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lab.stored_results import Collection
from lab.tables import PAPER_BY_NAME, UnsafeCounts, counts_by_seed, spread
from wrongturn_agents.stored_results import ALGORITHMS

_LEVEL: Final = 0.05
_EXACT: Final = 1_000_000  # most assignments that are all tried; of more, a random sample is
_SAMPLE: Final = 99_999
_SEED: Final = 20_210_711  # fixed, so that the same counts give the same p-value
_BATCH: Final = 20_000

COMPARED: Final = ("ppo-segmentation", "ppo-image", "ppo-auxiliary")
"""The agents that the paper's authors trained, from the most unsafe to the least. Others trained the rest."""
Counts = Mapping[str, Sequence[int]]
"""Unsafe counts by algorithm, one a seed; algorithms from the paper's most unsafe to its least."""


class OrderTest(NamedTuple):
    """Result of a permutation test of an order."""

    p: float
    """Probability of a trend at least as clear in this direction if the algorithm makes no difference."""
    ways: int
    """Number of assignments of the counts to the algorithms that the test tried."""
    exact: bool
    """Whether the test tried all possible assignments."""


@lru_cache(maxsize=64)
def order_test(counts: tuple[tuple[int, ...], ...]) -> OrderTest:
    """Run a one-sided permutation test of the Jonckheere-Terpstra statistic.

    The statistic counts the pairs of seeds from two algorithms that are in the given order; a tie counts half.

    Args:
        counts: Counts of at least two algorithms, with at least two seeds each.
    """
    from scipy import stats as scipy_stats  # takes a second

    ways = math.factorial(sum(map(len, counts))) // math.prod(math.factorial(len(one)) for one in counts)
    exact = ways <= _EXACT
    found = scipy_stats.permutation_test(
        [np.array(one, np.float64) for one in counts],
        _in_order,
        permutation_type="independent",
        vectorized=True,
        alternative="greater",
        n_resamples=_EXACT if exact else _SAMPLE,
        batch=_BATCH,
        rng=np.random.default_rng(_SEED),
    )
    return OrderTest(float(found.pvalue), ways if exact else _SAMPLE, exact)


def _in_order(*samples: NDArray[np.float64], axis: int = -1) -> Any:
    """Count the pairs in the order of the samples; the seeds are along the last axis."""
    assert axis == -1
    pairs = [(one[..., :, None], two[..., None, :]) for one, two in itertools.combinations(samples, 2)]
    return sum(((more > less) + 0.5 * (more == less)).sum((-1, -2)) for more, less in pairs)


def unsafe_by_seed(collection: Collection, names: Sequence[str] = COMPARED) -> dict[str, tuple[int, ...]]:
    """Return the unsafe trials of 60 (paper's column) of algorithms or variants, one for each seed that drives."""
    return {name: tuple(one.unsafe for one in _by_seed(collection, name).values() if one.drives) for name in names}


def _by_seed(collection: Collection, name: str) -> dict[int, UnsafeCounts]:
    found = counts_by_seed(collection, name).items()
    return {seed: one for seed, one in found if seed is not None}


def order_in_words(collection: Collection) -> str:
    """Return the paragraphs that say whether the paper's order holds, and which seeds they leave out."""
    in_order = sorted(ALGORITHMS, key=lambda name: -PAPER_BY_NAME[name].unsafe)
    every = describe_all(unsafe_by_seed(collection, in_order))
    return describe_order(unsafe_by_seed(collection)) + every + seeds_left_out(collection)


def seeds_left_out(collection: Collection) -> str:
    """Return a sentence that names the seeds left out because they do not drive; empty if all drive."""
    named = [
        f"`{name}` seed {seed} ({one.completed} of {one.twins})"
        for name in ALGORITHMS
        for seed, one in _by_seed(collection, name).items()
        if not one.drives
    ]
    said = f"\nSeeds that cannot drive are left out (completed twins in brackets): {', '.join(named)}.\n"
    return said if named else ""


def describe_order(counts: Counts) -> str:
    """Return a paragraph that says whether the paper's order holds."""
    few = [f"`{name}`" for name, found in counts.items() if len(found) < 2]
    if few:
        return (
            f"It cannot be said yet whether the paper's order ({_paper(counts)}, one seed each) holds over seeds: "
            f"fewer than two seeds of {', '.join(few)} that drive are stored.\n"
        )
    test = order_test(tuple(map(tuple, counts.values())))
    ways = f"all {test.ways:,} ways" if test.exact else f"{test.ways:,} random ways"
    same = _descending([median(found) for found in counts.values()])
    picks = list(itertools.product(*counts.values()))
    p_of_pair = {
        (one, two): order_test((tuple(counts[one]), tuple(counts[two]))).p
        for one, two in itertools.combinations(counts, 2)
    }
    pairs = "; ".join(f"`{one}` above `{two}`, p = {p:.2g}" for (one, two), p in p_of_pair.items())
    alike = [names for names in itertools.pairwise(counts) if p_of_pair[names] > _LEVEL]
    return (
        f"The paper counts {_paper(counts)} unsafe trials of 60, with one training seed each. Our medians "
        f"[lowest–highest] over seeds: {_shown(counts)}. The medians are {'' if same else 'not '}in the paper's order. "
        f"A one-sided permutation test over seeds (Jonckheere-Terpstra, {ways} to assign the counts to the "
        f"algorithms) gives p = {test.p:.2g}: {_conclusion(test, alike, same=same)} "
        f"The same test for each pair, not corrected for multiple tests: {pairs}. "
        f"If you pick one seed of each algorithm, {sum(map(_descending, picks))} of the {len(picks)} possible picks "
        "show the paper's strict order.\n"
    )


def describe_all(counts: Counts) -> str:
    """Return a paragraph about all of the paper's agents; empty while one has fewer than two seeds that drive."""
    if min(map(len, counts.values())) < 2:
        return ""
    test = order_test(tuple(map(tuple, counts.values())))
    same = _descending([median(found) for found in counts.values()])
    return (
        f"\nThe paper's other two agents were trained by others, so the test leaves them out. With them the paper's "
        f"order is {_paper(counts)}. Our medians: {_shown(counts)}. They are {'' if same else 'not '}in that order. "
        f"The same test over all five, which differ in more than one thing, gives p = {test.p:.2g}.\n"
    )


def _paper(counts: Counts) -> str:
    return " > ".join(str(PAPER_BY_NAME[name].unsafe) for name in counts)


def _shown(counts: Counts) -> str:
    return ", ".join(f"`{name}` {spread(found)} ({len(found)} seeds)" for name, found in counts.items())


def _conclusion(test: OrderTest, alike: list[tuple[str, str]], *, same: bool) -> str:
    """Return what may be concluded at 5 %: the order holds only if each agent differs from the next."""
    if test.p > _LEVEL:
        return "these seeds do not show the paper's order."
    if alike:
        named = " or ".join(f"`{first}` from `{second}`" for first, second in alike)
        return f"there is a trend in the paper's direction, but it does not separate {named}."
    if not same:
        return "there is a trend in the paper's direction, but no more than that."
    return "the order holds, and each agent differs from the next."


def _descending(values: Sequence[float]) -> bool:
    return all(more > less for more, less in itertools.pairwise(values))
