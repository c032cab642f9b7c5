"""Whether the paper's order of its agents holds over training seeds, in its own column.

The test is of the three agents that the paper's authors trained, 35 > 16 > 3 unsafe. They differ in one thing each.
The other two were trained by others, and stand beside them.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from statistics import median
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from lab.tables import spread
from lab.wrong_command import counts_by_seed
from wrongturn_agents.paper import ALGORITHMS, COMPARED, PAPER_BY_NAME
from wrongturn_agents.statistics import scipy_stats
from wrongturn_agents.stored_results import Collection

_LEVEL: Final = 0.05
_EXACT: Final = 1_000_000  # most assignments that are all tried; of more, a random sample is
_SAMPLE: Final = 99_999
_SEED: Final = 20_210_711  # fixed, so that the same counts give the same p-value
_BATCH: Final = 20_000

Counts = tuple[tuple[int, ...], ...]
"""Unsafe counts of each algorithm, one a seed; algorithms from the paper's most unsafe to its least."""


@dataclass(frozen=True)
class OrderTest:
    """Result of a permutation test of an order."""

    p: float
    """Probability of a trend at least as clear in this direction if the algorithm makes no difference."""
    ways: int
    """Number of assignments of the counts to the algorithms that the test tried."""
    exact: bool
    """Whether the test tried all possible assignments."""


@lru_cache(maxsize=64)
def order_test(counts: Counts) -> OrderTest:
    """Run a one-sided permutation test of the Jonckheere-Terpstra statistic.

    The statistic counts the pairs of seeds from two algorithms that are in the given order; a tie counts half.

    Args:
        counts: Counts of at least two algorithms, with at least two seeds each.

    Raises:
        MissingPackageError: scipy is not installed.
        ValueError: There are too few counts.
    """
    if len(counts) < 2 or min(map(len, counts)) < 2:
        raise ValueError("counts: too few for a test; give two algorithms at least, and two seeds of each")
    ways = math.factorial(sum(map(len, counts))) // math.prod(math.factorial(len(one)) for one in counts)
    exact = ways <= _EXACT
    found = scipy_stats().permutation_test(
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


def _in_order(*samples: NDArray[np.float64], axis: int = -1) -> NDArray[np.float64]:
    """Count the pairs in the order of the samples; the seeds are along the last axis."""
    assert axis == -1
    total = np.zeros(samples[0].shape[:-1])
    for first, second in itertools.combinations(samples, 2):
        more, less = first[..., :, None], second[..., None, :]
        total += ((more > less) + 0.5 * (more == less)).sum((-1, -2))
    return total


def unsafe_by_seed(collection: Collection, names: Sequence[str] = COMPARED) -> dict[str, tuple[int, ...]]:
    """Return the unsafe trials of 60 (paper's column) of algorithms, one for each seed that drives."""
    return {
        name: tuple(
            one.unsafe for seed, one in counts_by_seed(collection, name).items() if seed is not None and one.drives
        )
        for name in names
    }


def order_in_words(collection: Collection) -> str:
    """Return the paragraph that says whether the paper's order holds, and which seeds it leaves out."""
    in_order = sorted(ALGORITHMS, key=lambda name: -PAPER_BY_NAME[name].unsafe)
    every = describe_all(unsafe_by_seed(collection, in_order))
    return describe_order(unsafe_by_seed(collection)) + every + seeds_left_out(collection)


def seeds_left_out(collection: Collection) -> str:
    """Return a sentence that names the seeds left out because they do not drive; empty if all drive."""
    named = [
        f"`{name}` seed {seed} ({one.completed} of {one.twins})"
        for name in ALGORITHMS
        for seed, one in counts_by_seed(collection, name).items()
        if seed is not None and not one.drives
    ]
    if not named:
        return ""
    return f"Seeds that cannot drive are left out (completed twins in brackets): {', '.join(named)}.\n"


def describe_order(counts: Mapping[str, Sequence[int]]) -> str:
    """Return a paragraph that says whether the paper's order holds.

    Args:
        counts: Unsafe trials of 60 by algorithm, one a seed, in the paper's order.
    """
    paper = " > ".join(str(PAPER_BY_NAME[name].unsafe) for name in counts)
    few = [name for name, found in counts.items() if len(found) < 2]
    if few:
        known = "; ".join(f"`{name}` {', '.join(map(str, found))}" for name, found in counts.items() if found)
        return (
            f"It cannot be said yet whether the paper's order ({paper}, one seed each) holds over seeds: fewer than "
            f"two seeds of {', '.join(f'`{name}`' for name in few)} drive."
            f"{f' Unsafe of 60, each seed: {known}.' if known else ''}\n"
        )
    test = order_test(tuple(tuple(found) for found in counts.values()))
    ways = f"all {test.ways:,} ways" if test.exact else f"{test.ways:,} random ways"
    shown = ", ".join(f"`{name}` {spread(found)} ({len(found)} seeds)" for name, found in counts.items())
    same = _descending([median(found) for found in counts.values()])
    picks = list(itertools.product(*counts.values()))
    p_of_pair = {
        (first, second): order_test((tuple(counts[first]), tuple(counts[second]))).p
        for first, second in itertools.combinations(counts, 2)
    }
    pairs = "; ".join(f"`{first}` above `{second}`, p = {p:.2g}" for (first, second), p in p_of_pair.items())
    alike = [names for names in itertools.pairwise(counts) if p_of_pair[names] > _LEVEL]
    return (
        f"The paper counts {paper} unsafe trials of 60, with one training seed each. Our medians [lowest–highest] "
        f"over seeds: {shown}. The medians are {'' if same else 'not '}in the paper's order. "
        f"A one-sided permutation test over seeds (Jonckheere-Terpstra, {ways} to assign the counts to the "
        f"algorithms) gives p = {test.p:.2g}: {_conclusion(test, alike, same=same)} "
        f"The same test for each pair, not corrected for multiple tests: {pairs}. "
        f"If you pick one seed of each algorithm, {sum(map(_descending, picks))} of the {len(picks)} possible picks "
        "show the paper's strict order.\n"
    )


def describe_all(counts: Mapping[str, Sequence[int]]) -> str:
    """Return a paragraph about all of the paper's agents; empty while one has fewer than two seeds that drive.

    Args:
        counts: Unsafe trials of 60 by algorithm, one a seed, in the paper's order.
    """
    if min(map(len, counts.values())) < 2:
        return ""
    test = order_test(tuple(tuple(found) for found in counts.values()))
    same = _descending([median(found) for found in counts.values()])
    paper = " > ".join(str(PAPER_BY_NAME[name].unsafe) for name in counts)
    shown = ", ".join(f"`{name}` {spread(found)} ({len(found)} seeds)" for name, found in counts.items())
    return (
        f"\nThe paper's other two agents were trained by others, so the test leaves them out. With them the paper's "
        f"order is {paper}. Our medians: {shown}. They are {'' if same else 'not '}in that order. The same test over "
        "all five, which differ in more than one thing, gives "
        f"p = {test.p:.2g}.\n\n"
    )


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


def as_json(collection: Collection) -> dict[str, Any]:
    """Return the test for a program."""
    counts = unsafe_by_seed(collection)
    test = order_test(tuple(counts.values())) if min(map(len, counts.values())) > 1 else None
    return {
        "paper": {name: agent.unsafe for name, agent in PAPER_BY_NAME.items()},
        "unsafe_by_seed": {name: list(found) for name, found in unsafe_by_seed(collection, ALGORITHMS).items()},
        "p": None if test is None else test.p,
        "ways": None if test is None else test.ways,
        "exact": None if test is None else test.exact,
    }
