import itertools

import pytest
from made_results import keep, wrong_command

from wrongturn_agents.reporting.collection import Collection
from wrongturn_agents.reporting.order import describe_all, describe_order, order_in_words, order_test, unsafe_by_seed


def test_the_p_value_is_the_share_of_all_ways_of_dealing():
    # Of the 20 ways to deal six different counts to two of three, one alone is as clear as this.
    test = order_test(((9, 8, 7), (3, 2, 1)))
    assert (test.exact, test.ways) == (True, 20)
    assert test.p == pytest.approx(1 / 20)
    assert order_test(((3, 2, 1), (9, 8, 7))).p == pytest.approx(1)


def test_three_algorithms_against_counting_by_hand():
    counts = ((9, 4), (5, 6), (3, 1))

    def pairs(dealt):
        return sum(a > b for first, second in itertools.combinations(dealt, 2) for a in first for b in second)

    values = [value for one in counts for value in one]
    as_clear, ways = 0, 0
    for order in itertools.permutations(values):
        ways += 1
        as_clear += pairs((order[:2], order[2:4], order[4:])) >= pairs(counts)
    test = order_test(counts)
    assert test.ways == 90
    assert test.p == pytest.approx(as_clear / ways)


def test_too_few_counts():
    with pytest.raises(ValueError, match="two seeds of each"):
        order_test(((1,), (2, 3)))


def test_an_order_that_holds_is_said_to_hold():
    counts = {"ppo-segmentation": (30, 35, 40), "ppo-image": (20, 18, 22), "ppo-auxiliary": (3, 5, 9)}
    text = describe_order(counts)
    assert "35 > 16 > 3" in text
    assert "The medians are in the paper's order." in text
    assert "all 1,680 ways" in text
    assert "the order holds, and each agent differs from the next" in text
    assert "27 of the 27 possible picks" in text


def test_an_order_that_does_not_hold_is_not_claimed():
    counts = {"ppo-segmentation": (10, 25, 28), "ppo-image": (20, 33, 28), "ppo-auxiliary": (10, 21, 30)}
    text = describe_order(counts)
    assert "The medians are not in the paper's order." in text
    assert "these seeds do not show the paper's order" in text


def test_a_trend_that_leaves_neighbours_alike_is_called_no_order():
    counts = {"ppo-segmentation": (30, 31, 32), "ppo-image": (29, 33, 28), "ppo-auxiliary": (3, 5, 9)}
    text = describe_order(counts)
    assert (
        "there is a trend in the paper's direction, but it does not separate `ppo-segmentation` from `ppo-image`."
        in text
    )


def test_one_seed_says_nothing():
    text = describe_order({"ppo-segmentation": (30, 35), "ppo-image": (20,), "ppo-auxiliary": ()})
    assert "cannot be said yet" in text
    assert "`ppo-image`, `ppo-auxiliary`" in text


def test_counts_come_from_the_algorithms_as_they_are(tmp_path):
    keep(
        tmp_path,
        wrong_command("ppo-image", (1, 0, 0, 0, 0, 0), seed=1),
        wrong_command("ppo-image", (1, 1, 1, 0, 0, 0), seed=2),
        wrong_command("ppo-image", (9, 9, 9, 9, 9, 9), seed=3, variant="without-augmentation"),
    )
    assert unsafe_by_seed(Collection.read(tmp_path))["ppo-image"] == (1, 3)


def test_all_five_stand_beside_the_three_once_each_has_two_seeds(tmp_path):
    unsafe = {"ppo-segmentation": 9, "lbc": 7, "ppo-image": 5, "marln": 3, "ppo-auxiliary": 1}
    files = [
        wrong_command(name, (count, 0, 0, 0, 0, 0), seed=seed) for name, count in unsafe.items() for seed in (1, 2)
    ]
    kept = keep(tmp_path, *files[:-6], *files[-4:])
    assert "others" not in order_in_words(Collection.read(kept))
    text = order_in_words(Collection.read(keep(tmp_path, *files)))
    assert "35 > 16 > 3" in text
    assert "35 > 23 > 16 > 13 > 3" in text
    assert "They are in that order." in text
    assert "gives p = 8.8e-06." in text  # one of 113,400 ways
    assert "They are not in that order." in describe_all(dict.fromkeys(unsafe, (5, 6)))
