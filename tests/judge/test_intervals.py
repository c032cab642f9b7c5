"""Intervals and tests against values worked out by hand, and their general promises."""

import itertools
import math
import subprocess
import sys
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wrongturn_judge.intervals import cluster_bootstrap, mcnemar_two_sided, stratified_exact, wilson

counts = st.integers(1, 200).flatmap(lambda trials: st.tuples(st.integers(0, trials), st.just(trials)))
clusters = st.dictionaries(
    st.tuples(st.sampled_from(("Town01", "Town02")), st.sampled_from([f"J{n}" for n in range(1, 13)])),
    st.lists(st.sampled_from((-1, 0, 1)), min_size=1, max_size=6),
    min_size=1,
    max_size=12,
)


def wilson_by_hand(count: int, trials: int) -> tuple[float, float]:
    z = 1.959963984540054
    rate = count / trials
    centre = (rate + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z / (1 + z * z / trials) * math.sqrt(rate * (1 - rate) / trials + z * z / (4 * trials * trials))
    return centre - half, centre + half


@pytest.mark.parametrize(
    ("count", "low", "high"),
    [(3, 0.017149, 0.137005), (0, 0.0, 0.060172), (60, 0.939828, 1.0), (30, 0.377349, 0.622651)],
)
def test_wilson_of_sixty(count: int, low: float, high: float) -> None:
    assert wilson(count, 60) == pytest.approx((low, high), abs=1e-5)


@given(counts)
def test_wilson_is_its_formula_and_holds_the_rate(pair: tuple[int, int]) -> None:
    count, trials = pair
    low, high = wilson(count, trials)
    assert 0 <= low <= count / trials <= high <= 1
    assert low < high
    assert (low, high) == pytest.approx(wilson_by_hand(count, trials), abs=1e-12)


@pytest.mark.parametrize(("count", "trials"), [(0, 0), (-1, 60), (61, 60)])
def test_wilson_refuses_what_is_no_rate(count: int, trials: int) -> None:
    with pytest.raises(ValueError, match="no rate"):
        wilson(count, trials)


@pytest.mark.parametrize(
    ("first", "second", "p"),
    # 2 * P(X <= min) of Binomial(first + second, 1/2), at most 1.
    [(0, 0, 1.0), (5, 5, 1.0), (1, 0, 1.0), (5, 0, 2 / 32), (6, 0, 2 / 64), (8, 1, 2 * 10 / 512), (20, 0, 2 / 2**20)],
)
def test_mcnemar_two_sided(first: int, second: int, p: float) -> None:
    assert mcnemar_two_sided(first, second) == pytest.approx(p)
    assert mcnemar_two_sided(second, first) == pytest.approx(p)


def by_permutation(strata: list[tuple[int, int, int, int]]) -> float:
    """The p-value by dealing each stratum's marks to the two agents in every possible way."""
    dealt = []
    for count_a, trials_a, count_b, trials_b in strata:
        marks = [1] * (count_a + count_b) + [0] * (trials_a + trials_b - count_a - count_b)
        dealt.append([sum(marks[k] for k in chosen) for chosen in itertools.combinations(range(len(marks)), trials_a)])
    ways = Counter(sum(sums) for sums in itertools.product(*dealt))
    seen = ways[sum(stratum[0] for stratum in strata)]
    return sum(number for number in ways.values() if number <= seen) / sum(ways.values())


small = st.tuples(st.integers(1, 4), st.integers(1, 4)).flatmap(
    lambda n: st.tuples(st.integers(0, n[0]), st.just(n[0]), st.integers(0, n[1]), st.just(n[1]))
)
of_ten = st.tuples(st.integers(0, 10), st.just(10), st.integers(0, 10), st.just(10))


@given(st.lists(small, min_size=1, max_size=3))
@settings(max_examples=40)
def test_the_exact_test_is_what_permutations_give(strata: list[tuple[int, int, int, int]]) -> None:
    assert stratified_exact(strata) == pytest.approx(by_permutation(strata))


@given(counts, counts)
@settings(max_examples=100)
def test_one_stratum_is_fishers_exact_test(a: tuple[int, int], b: tuple[int, int]) -> None:
    from scipy.stats import fisher_exact

    table = [[a[0], a[1] - a[0]], [b[0], b[1] - b[0]]]
    assert stratified_exact([(*a, *b)]) == pytest.approx(fisher_exact(table).pvalue, rel=1e-6)


@given(st.lists(of_ten, min_size=6, max_size=6))
@settings(max_examples=40)
def test_the_exact_test_is_symmetric(strata: list[tuple[int, int, int, int]]) -> None:
    p = stratified_exact(strata)
    assert 0 < p <= 1
    assert stratified_exact([(b, m, a, n) for a, n, b, m in strata]) == pytest.approx(p)
    assert stratified_exact(strata[::-1]) == pytest.approx(p)
    assert stratified_exact([(n - a, n, m - b, m) for a, n, b, m in strata]) == pytest.approx(p)


def test_strata_without_a_difference_say_nothing() -> None:
    # Where both agents fail always or never, nothing can be learned.
    assert stratified_exact([(10, 10, 10, 10), (0, 10, 0, 10)]) == pytest.approx(1.0)
    alone = stratified_exact([(0, 10, 5, 10)])
    assert stratified_exact([(0, 10, 5, 10), (10, 10, 10, 10), (0, 10, 0, 10)]) == pytest.approx(alone)


def test_strata_see_what_a_sum_hides() -> None:
    # 10 against 15 of 20. Within strata of rates 0.5 and 1 the same five are sharper.
    assert stratified_exact([(0, 10, 5, 10), (10, 10, 10, 10)]) < stratified_exact([(10, 20, 15, 20)])


def test_the_exact_test_refuses_what_is_no_count() -> None:
    with pytest.raises(ValueError, match="no counts"):
        stratified_exact([(3, 2, 0, 2)])


@given(clusters)
@settings(max_examples=40)
def test_bootstrap_holds_the_mean_and_repeats_itself(groups: dict[tuple[str, str], list[int]]) -> None:
    values = [value for group in groups.values() for value in group]
    low, high = cluster_bootstrap(groups)
    assert -1 <= low <= sum(values) / len(values) <= high <= 1
    backwards = {name: groups[name][::-1] for name in reversed(list(groups))}
    assert cluster_bootstrap(backwards) == (low, high)


@given(clusters, st.sampled_from((-1, 0, 1)))
@settings(max_examples=20)
def test_bootstrap_of_equal_trials_is_their_value(groups: dict[tuple[str, str], list[int]], value: int) -> None:
    assert cluster_bootstrap({name: [value] * len(group) for name, group in groups.items()}) == (value, value)


def test_bootstrap_of_one_cluster_is_its_mean() -> None:
    assert cluster_bootstrap({("Town01", "J1"): [0, 0, 1, 0]}) == (0.25, 0.25)


def test_bootstrap_of_two_clusters() -> None:
    # A draw of two holds the same one twice with probability 1/4 each, so both ends are reached.
    assert cluster_bootstrap({("T", "J1"): [1, 1], ("T", "J2"): [0, 0]}) == (0.0, 1.0)


def test_bootstrap_takes_whole_junctions() -> None:
    # Twelve junctions that agree within themselves say less than sixty independent trials would.
    together = cluster_bootstrap({("T", f"J{n}"): [int(n < 6)] * 5 for n in range(12)})
    apart = cluster_bootstrap({("T", f"J{n:02}"): [int(n < 30)] for n in range(60)})
    assert together[1] - together[0] > 1.5 * (apart[1] - apart[0])


def test_bootstrap_refuses_nothing() -> None:
    with pytest.raises(ValueError, match="at least one"):
        cluster_bootstrap({})


def test_importing_it_does_not_wait_for_scipy() -> None:
    code = "import sys, wrongturn_judge.ranking, wrongturn_judge.metrics; print('scipy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
