"""Intervals and tests against values worked out by hand, and their general promises."""

import itertools
import math
import random
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wrongturn_judge.intervals import difference_interval, exact_test, mcnemar_two_sided
from wrongturn_protocol.intervals import Marks, interval, student, wilson

counts = st.integers(1, 200).flatmap(lambda trials: st.tuples(st.integers(0, trials), st.just(trials)))
in_stratum = st.integers(1, 12).flatmap(lambda trials: st.tuples(st.integers(0, trials), st.just(trials)))
strata = st.lists(in_stratum, min_size=1, max_size=7)
towns = st.lists(st.lists(st.integers(0, 1), min_size=6, max_size=6), min_size=2, max_size=10)
LEVELS = st.sampled_from((0.001, 0.05, 0.166, 0.4))


def of_strata(cells: Sequence[tuple[int, int]]) -> Marks:
    return {str(number): {"Town01.J1-N": cell} for number, cell in enumerate(cells)}


def of_towns(rows: Sequence[Sequence[int]], town: str = "drawn-{:016x}") -> Marks:
    """A trial of each of six cells in each town."""
    columns = zip(*rows, strict=True)
    return {
        str(cell): {f"{town.format(number)}.J1-N": (unsafe, 1) for number, unsafe in enumerate(column)}
        for cell, column in enumerate(columns)
    }


marks = st.one_of(strata.map(of_strata), towns.map(of_towns))


def rate(of: Marks) -> float:
    cells = [cell for places in of.values() for cell in places.values()]
    return sum(count for count, _ in cells) / sum(trials for _, trials in cells)


def complement(of: Marks) -> Marks:
    return {name: {place: (n - x, n) for place, (x, n) in places.items()} for name, places in of.items()}


def wilson_by_hand(count: int, trials: int) -> tuple[float, float]:
    z = 1.959963984540054
    share = count / trials
    centre = (share + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z / (1 + z * z / trials) * math.sqrt(share * (1 - share) / trials + z * z / (4 * trials * trials))
    return centre - half, centre + half


@given(counts)
@settings(max_examples=40)
def test_one_stratum_has_wilsons_interval(pair: tuple[int, int]) -> None:
    assert wilson(*pair) == pytest.approx(wilson_by_hand(*pair), abs=1e-12)
    assert wilson(*pair, 0.166) == interval({"": {"a": pair}}, 0.166)


@given(marks, LEVELS)
@settings(max_examples=40)
def test_an_interval_holds_the_rate_and_is_no_point(of: Marks, level: float) -> None:
    low, high = interval(of, level)
    assert 0 <= low <= rate(of) <= high <= 1
    assert low < high


@given(marks, LEVELS)
@settings(max_examples=40)
def test_safe_for_unsafe_mirrors_the_interval(of: Marks, level: float) -> None:
    low, high = interval(of, level)
    assert interval(complement(of), level) == pytest.approx((1 - high, 1 - low))


@given(marks)
@settings(max_examples=40)
def test_a_higher_level_gives_a_wider_interval(of: Marks) -> None:
    ends = [interval(of, level) for level in (0.4, 0.166, 0.05, 0.001)]
    assert all(wide[0] <= narrow[0] and narrow[1] <= wide[1] for narrow, wide in itertools.pairwise(ends))


@given(marks, st.randoms(use_true_random=False))
@settings(max_examples=40)
def test_the_order_of_strata_and_places_changes_nothing(of: Marks, generator: random.Random) -> None:
    names = generator.sample(sorted(of), len(of))
    assert interval({name: dict(reversed(of[name].items())) for name in names}) == interval(of)


@given(st.lists(st.integers(0, 10), min_size=6, max_size=6), st.integers(0, 5), st.sampled_from((0.05, 0.166)))
@settings(max_examples=40)
def test_an_unsafe_trial_more_moves_the_interval_up(cells: list[int], where: int, level: float) -> None:
    cells[where] = min(cells[where], 9)
    more = [count + (number == where) for number, count in enumerate(cells)]
    before, after = (interval(of_strata([(count, 10) for count in one]), level) for one in (cells, more))
    assert before[0] <= after[0]
    assert before[1] <= after[1]


@given(strata, LEVELS)
@settings(max_examples=40)
def test_strata_never_widen_an_interval(cells: list[tuple[int, int]], level: float) -> None:
    low, high = interval(of_strata(cells), level)
    plain = wilson(sum(count for count, _ in cells), sum(trials for _, trials in cells), level)
    assert plain[0] - 1e-12 <= low
    assert high <= plain[1] + 1e-12


def test_the_papers_sixty() -> None:
    def of(*cells: int, level: float = 0.05) -> tuple[float, float]:
        return interval(of_strata([(count, 10) for count in cells]), level)

    assert of(0, 0, 0, 0, 0, 0) == pytest.approx((0, 0.060172), abs=1e-6)
    assert of(10, 10, 10, 10, 10, 10) == pytest.approx((0.939828, 1), abs=1e-6)
    assert of(1, 1, 1, 0, 0, 0) == pytest.approx(wilson(3, 60))
    # All that can differ in another draw is within cells.
    assert of(10, 0, 0, 0, 0, 0) == pytest.approx((0.119352, 0.227884), abs=1e-6)
    assert wilson(10, 60) == pytest.approx((0.0931, 0.2803), abs=5e-4)


def test_single_trials_are_one_stratum() -> None:
    # As in smoke, which has one trial of each cell.
    for count in range(7):
        assert interval(of_strata([(int(cell < count), 1) for cell in range(6)])) == pytest.approx(wilson(count, 6))


@given(towns)
@settings(max_examples=40)
def test_drawn_towns_widen_an_interval(rows: list[list[int]]) -> None:
    fixed, drawn = interval(of_towns(rows, "Town{:02}")), interval(of_towns(rows))
    assert drawn[0] <= fixed[0]
    assert fixed[1] <= drawn[1]


def test_towns_that_differ_widen_it_more() -> None:
    alike = [[1, 1, 0, 0, 0, 0]] * 4 + [[0, 0, 1, 1, 0, 0]] * 4
    apart = [[1, 1, 1, 1, 0, 0]] * 4 + [[0] * 6] * 4
    assert rate(of_towns(alike)) == rate(of_towns(apart))
    (low, high), (lower, higher) = interval(of_towns(alike)), interval(of_towns(apart))
    assert higher - lower > 1.5 * (high - low)


@pytest.mark.parametrize("freedom", [1, 2, 5, 9, 30])
def test_the_series_is_students_quantile(freedom: int) -> None:
    from scipy.stats import norm, t

    for level in (0.05, 0.166):
        found, right = student(float(norm.ppf(1 - level / 2)), freedom), float(t.ppf(1 - level / 2, freedom))
        assert found == pytest.approx(right, rel=0.12 if freedom < 5 else 2e-4)


@pytest.mark.parametrize(("count", "trials"), [(0, 0), (-1, 60), (61, 60)])
def test_an_interval_refuses_what_is_no_rate(count: int, trials: int) -> None:
    with pytest.raises(ValueError, match="no rate"):
        wilson(count, trials)


@given(marks, marks)
@settings(max_examples=40)
def test_a_difference_holds_its_value_and_turns_round(a: Marks, b: Marks) -> None:
    low, high = difference_interval(a, b)
    assert -1 <= low <= rate(a) - rate(b) <= high <= 1
    assert difference_interval(b, a) == pytest.approx((-high, -low))


@pytest.mark.parametrize(
    ("first", "second", "p"),
    # 2 * P(X <= min) of Binomial(first + second, 1/2), at most 1.
    [(0, 0, 1.0), (5, 5, 1.0), (1, 0, 1.0), (5, 0, 2 / 32), (6, 0, 2 / 64), (8, 1, 2 * 10 / 512), (20, 0, 2 / 2**20)],
)
def test_mcnemar_two_sided(first: int, second: int, p: float) -> None:
    assert mcnemar_two_sided(first, second) == pytest.approx(p)
    assert mcnemar_two_sided(second, first) == pytest.approx(p)


def by_permutation(dealt: list[tuple[list[int], list[int]]]) -> float:
    """The p-value by dealing each stratum's units to the two agents in every possible way."""
    ways = [[sum(hand) for hand in itertools.combinations([*a, *b], len(a))] for a, b in dealt]
    found = Counter(sum(sums) for sums in itertools.product(*ways))
    seen = found[sum(sum(a) for a, _ in dealt)]
    return sum(number for number in found.values() if number <= seen) / sum(found.values())


def trials(count: int, of: int) -> list[int]:
    return [1] * count + [0] * (of - count)


hand = st.lists(st.integers(0, 3), min_size=1, max_size=4)


@given(st.lists(st.tuples(hand, hand), min_size=1, max_size=3))
@settings(max_examples=40)
def test_the_exact_test_is_what_permutations_give(units: list[tuple[list[int], list[int]]]) -> None:
    assert exact_test(units) == pytest.approx(by_permutation(units))


@given(counts, counts)
@settings(max_examples=100)
def test_one_stratum_is_fishers_exact_test(a: tuple[int, int], b: tuple[int, int]) -> None:
    from scipy.stats import fisher_exact

    table = [[a[0], a[1] - a[0]], [b[0], b[1] - b[0]]]
    assert exact_test([(trials(*a), trials(*b))]) == pytest.approx(fisher_exact(table).pvalue, rel=1e-6)


def test_strata_without_a_difference_say_nothing() -> None:
    # Where both agents fail always or never, or one has no trial, nothing can be learned.
    idle = [([1] * 10, [1] * 10), ([0] * 10, [0] * 10), ([], [1, 0])]
    assert exact_test(idle) == 1.0
    assert exact_test([(trials(0, 10), trials(5, 10)), *idle]) == exact_test([(trials(0, 10), trials(5, 10))])


def test_the_exact_test_takes_many_trials_and_refuses_what_is_no_count() -> None:
    assert exact_test([(trials(100, 600), trials(100, 600))]) == pytest.approx(1.0)
    assert exact_test([(trials(100, 600), trials(150, 600))]) < 0.001
    with pytest.raises(ValueError, match="no count"):
        exact_test([([-1], [0])])


def test_importing_it_does_not_wait_for_scipy() -> None:
    code = "import sys, wrongturn_judge.ranking, wrongturn_judge.metrics; print('scipy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
