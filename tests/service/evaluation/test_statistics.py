"""Intervals and tests against values worked out by hand, and their general promises."""

import math
import subprocess
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wrongturn_service.evaluation.statistics import (
    cluster_bootstrap,
    holm_rejections,
    mcnemar_one_sided,
    mcnemar_two_sided,
    wilson,
)

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


@pytest.mark.parametrize(
    ("worse", "better", "p"),
    [(0, 0, 1.0), (5, 0, 1 / 32), (4, 0, 1 / 16), (8, 1, 10 / 512), (0, 5, 1.0), (1, 8, 511 / 512)],
)
def test_mcnemar_one_sided(worse: int, better: int, p: float) -> None:
    assert mcnemar_one_sided(worse, better) == pytest.approx(p)


def test_holm_steps_down() -> None:
    # 0.01 <= 0.05/3, then 0.02 <= 0.05/2, then 0.04 <= 0.05.
    assert holm_rejections([0.04, 0.01, 0.02]) == (True, True, True)
    # 0.03 > 0.05/2 stops the descent, so that 0.04 stands although it is below 0.05.
    assert holm_rejections([0.04, 0.01, 0.03]) == (False, True, False)
    assert holm_rejections([0.02, 0.9, 0.9]) == (False, False, False)
    assert holm_rejections([]) == ()


@given(clusters)
@settings(max_examples=40, deadline=None)
def test_bootstrap_holds_the_mean_and_repeats_itself(groups: dict[tuple[str, str], list[int]]) -> None:
    values = [value for group in groups.values() for value in group]
    low, high = cluster_bootstrap(groups)
    assert -1 <= low <= sum(values) / len(values) <= high <= 1
    backwards = {name: groups[name][::-1] for name in reversed(list(groups))}
    assert cluster_bootstrap(backwards) == (low, high)


@given(clusters, st.sampled_from((-1, 0, 1)))
@settings(max_examples=20, deadline=None)
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
    code = "import sys, wrongturn_service.evaluation; print(any(m in sys.modules for m in ('scipy', 'statsmodels')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
