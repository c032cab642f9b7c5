"""Whether the paper's order of its three agents, 35 > 16 > 3 unsafe, holds over training seeds."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_agents.reporting.collection import Collection
from wrongturn_agents.reporting.errors import MissingPackageError
from wrongturn_agents.reporting.paper import ALGORITHMS, LIKE
from wrongturn_agents.reporting.spread import Spread
from wrongturn_agents.reporting.wrong_command import by_seed

_LEVEL: Final = 0.05
_EXACT: Final = 1_000_000
"""Ways of dealing the counts to the algorithms up to which all are tried."""
_DRAWS: Final = 99_999
"""Of them, where there are more."""
_SEED: Final = 20_210_711
"""Fixed, so that the same counts give the same p-value."""
_BATCH: Final = 20_000

Counts = tuple[tuple[int, ...], ...]
"""Unsafe counts, for each algorithm one a seed, in the paper's order from its most unsafe to its least."""


@dataclass(frozen=True)
class OrderTest:
    """What a permutation test says of an order."""

    p: float
    """How likely a trend in this direction at least as clear is, if the algorithm has no part in it."""
    ways: int
    """Of dealing the counts to the algorithms that were tried."""
    exact: bool
    """Whether these were all there are."""


@lru_cache(maxsize=64)
def order_test(counts: Counts) -> OrderTest:
    """Permutation test over seeds, one-sided, of the Jonckheere-Terpstra statistic.

    The statistic counts the pairs of seeds, of two algorithms, that stand in the order given; a tie counts half.

    Args:
        counts: of two algorithms at least, two seeds each at least.

    Raises:
        MissingPackageError: scipy is not installed.
        ValueError: there are too few counts.
    """
    if len(counts) < 2 or min(map(len, counts)) < 2:
        raise ValueError("counts: too few for a test; give two algorithms at least, and two seeds of each")
    try:
        from scipy.stats import permutation_test  # noqa: PLC0415 - takes a second to import
    except ImportError as error:
        raise MissingPackageError("scipy is not installed; install wrongturn-agents[training]") from error
    seeds = sum(map(len, counts))
    ways = math.factorial(seeds) // math.prod(math.factorial(len(one)) for one in counts)
    exact = ways <= _EXACT
    found = permutation_test(
        [np.array(one, np.float64) for one in counts],
        _in_order,
        permutation_type="independent",
        vectorized=True,
        alternative="greater",
        n_resamples=_EXACT if exact else _DRAWS,
        batch=_BATCH,
        rng=np.random.default_rng(_SEED),
    )
    return OrderTest(float(found.pvalue), ways if exact else _DRAWS, exact)


def _in_order(*samples: NDArray[np.float64], axis: int = -1) -> NDArray[np.float64]:
    """Pairs that stand in the order of the samples; the seeds lie along the last axis."""
    assert axis == -1
    total = np.zeros(samples[0].shape[:-1])
    for first, second in itertools.combinations(samples, 2):
        more, less = first[..., :, None], second[..., None, :]
        total += ((more > less) + 0.5 * (more == less)).sum((-1, -2))
    return total


def unsafe_by_seed(collection: Collection) -> dict[str, tuple[int, ...]]:
    """Unsafe of 60 for each of the paper's algorithms, one for each seed that drives."""
    counts = {name: by_seed(collection, name) for name in ALGORITHMS}
    return {
        name: tuple(one.unsafe for seed, one in found.items() if seed is not None and one.drives)
        for name, found in counts.items()
    }


def left_out(collection: Collection) -> str:
    """A sentence on the seeds that are not counted, for they do not drive; empty where all do."""
    named = [
        f"`{name}` {seed} ({one.completed} of {one.twins})"
        for name in ALGORITHMS
        for seed, one in by_seed(collection, name).items()
        if seed is not None and not one.drives
    ]
    if not named:
        return ""
    return f"Left out are seeds that cannot drive, by the twins that they completed: {', '.join(named)}.\n"


def order_in_words(counts: Mapping[str, Sequence[int]]) -> str:
    """A paragraph that says whether the paper's order holds.

    Args:
        counts: unsafe of 60 by algorithm, one a seed, in the paper's order.
    """
    paper = " > ".join(str(LIKE[name].unsafe) for name in counts)
    few = [name for name, found in counts.items() if len(found) < 2]
    if few:
        known = "; ".join(f"`{name}` {', '.join(map(str, found))}" for name, found in counts.items() if found)
        return (
            f"Whether the paper's order ({paper}, one seed each) holds over seeds cannot be said yet: of "
            f"{', '.join(f'`{name}`' for name in few)} there are fewer than two seeds that drive."
            f"{f' Unsafe of 60, each seed: {known}.' if known else ''}\n"
        )
    dealt = tuple(tuple(found) for found in counts.values())
    test = order_test(dealt)
    shown = ", ".join(f"`{name}` {Spread.of(found)} ({len(found)} seeds)" for name, found in counts.items())
    medians = [Spread.of(found).median for found in counts.values()]
    same = all(more > less for more, less in itertools.pairwise(medians))
    ways = f"all {test.ways:,} ways" if test.exact else f"{test.ways:,} random ways"
    draws = list(itertools.product(*dealt))
    like = sum(all(more > less for more, less in itertools.pairwise(draw)) for draw in draws)
    pairs = "; ".join(_pair(names, counts) for names in itertools.combinations(counts, 2))
    alike = [names for names in itertools.pairwise(counts) if _pair_test(names, counts).p > _LEVEL]
    return (
        f"The paper counts {paper} unsafe of 60, from one seed each. Over seeds, median [least–most]: {shown}. "
        f"{'The medians stand in its order.' if same else 'The medians do not stand in its order.'} "
        f"A permutation test over seeds (Jonckheere-Terpstra, one-sided, {ways} of dealing the counts to the "
        f"algorithms) gives p = {test.p:.2g}: {_verdict(test, alike, same=same)} "
        f"In pairs, by the same test and uncorrected: {pairs}. "
        f"Whoever trains one seed of each meets the paper's strict order in {like} of {len(draws)} draws.\n"
    )


def _verdict(test: OrderTest, alike: list[tuple[str, str]], *, same: bool) -> str:
    """What may be said at 5 %: the whole order only where each neighbour is told from the next."""
    if test.p > _LEVEL:
        return "these seeds do not show the paper's order."
    if alike or not same:
        told = " and ".join(f"`{first}` from `{second}`" for first, second in alike)
        return "there is a trend in its direction" + (f", which does not tell {told}." if told else ", no more.")
    return "the order holds, each agent told from the next."


def _pair_test(names: tuple[str, str], counts: Mapping[str, Sequence[int]]) -> OrderTest:
    return order_test((tuple(counts[names[0]]), tuple(counts[names[1]])))


def _pair(names: tuple[str, str], counts: Mapping[str, Sequence[int]]) -> str:
    return f"`{names[0]}` above `{names[1]}`, p = {_pair_test(names, counts).p:.2g}"


def as_json(collection: Collection) -> dict[str, Any]:
    """The test for a program."""
    counts = unsafe_by_seed(collection)
    enough = min(map(len, counts.values())) > 1
    test = order_test(tuple(counts.values())) if enough else None
    return {
        "paper": {name: LIKE[name].unsafe for name in counts},
        "unsafe_by_seed": {name: list(found) for name, found in counts.items()},
        "p": None if test is None else test.p,
        "ways": None if test is None else test.ways,
        "exact": None if test is None else test.exact,
    }
