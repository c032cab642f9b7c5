"""Who stands where: rules of eligibility, ranks, ties and order. ``test_rank_rules.py`` has the general promises."""

from dataclasses import replace

import pytest

from wrongturn_judge import RankingInput, compute, rank, ranking
from wrongturn_judge.comparison import Side, compare
from wrongturn_judge.ranking import least_completed, most_undecided
from wrongturn_protocol import AgentDetail, AgentKind, LeaderboardEntry, Seeds, SeedSpread, Track, Verdict


def colliding(kit, suite, name, where, track=Track.CAMERA, owner=""):
    return kit.row(suite, name, kit.outcomes_of(suite, dict.fromkeys(where, Verdict.COLLISION)), track, owner)


def standing(entries: list[LeaderboardEntry]) -> dict[str, int | None]:
    return {entry.agent.name: entry.rank for entry in entries}


CELL_BY_CELL = tuple(range(60))
EVENLY = tuple(place % 6 * 10 + place // 6 for place in range(60))


# The least count whose 83.4 % interval begins above the end of the first one's.
@pytest.mark.parametrize(
    ("order", "better", "worse"),
    [
        *((EVENLY, *pair) for pair in [(0, 4), (3, 10), (6, 14), (10, 20), (30, 41), (56, 60)]),
        *((CELL_BY_CELL, *pair) for pair in [(0, 4), (3, 9), (10, 16), (18, 24), (30, 36), (56, 60)]),
    ],
)
def test_intervals_that_touch_share_a_rank(kit, suite, order, better, worse) -> None:
    a = colliding(kit, suite, "a", order[:better])
    tied = rank([a, colliding(kit, suite, "b", order[: worse - 1])])
    assert standing(tied) == {"a": 1, "b": 1}
    assert {entry.agent.name: entry.tied_with for entry in tied} == {"a": ("b",), "b": ("a",)}
    apart = rank([a, colliding(kit, suite, "b", order[:worse])])
    assert standing(apart) == {"a": 1, "b": 2}
    assert [entry.tied_with for entry in apart] == [(), ()]


def test_the_places_of_unsafe_trials_do_not_matter(kit, suite) -> None:
    # Each evaluation draws its own trials, so nothing can be paired.
    field = [colliding(kit, suite, "a", range(10)), colliding(kit, suite, "b", range(30, 45))]
    assert standing(rank(field)) == {"a": 1, "b": 1}
    other_draw = kit.make_suite(first_seed=1000)
    assert not {trial.id for trial in other_draw.trials} & {trial.id for trial in suite.trials}
    field[1] = colliding(kit, other_draw, "b", range(20))
    assert standing(rank(field)) == {"a": 1, "b": 2}


def test_shipped_agents_count_against_each_other(kit, suite) -> None:
    """One owner answers for all of them: without this rule every baseline and exploit would share the first rank."""
    field = [colliding(kit, suite, name, range(count), owner="Us") for name, count in (("a", 0), ("b", 20), ("c", 50))]
    kinds = (AgentKind.BASELINE, AgentKind.EXPLOIT, AgentKind.REFERENCE)
    shipped = [
        replace(row, agent=row.agent.model_copy(update={"kind": kind})) for row, kind in zip(field, kinds, strict=True)
    ]
    assert standing(rank(shipped)) == {"a": 1, "b": 2, "c": 3}


def test_tracks_are_never_compared(kit, suite) -> None:
    field = [
        colliding(kit, suite, "all-seeing", range(0), Track.PRIVILEGED),
        colliding(kit, suite, "painter", range(30), Track.SEGMENTATION),
        colliding(kit, suite, "seer", range(40), Track.CAMERA),
    ]
    entries = rank(field)
    assert [(entry.agent.name, entry.rank, entry.tied_with) for entry in entries] == [
        ("seer", 1, ()),
        ("painter", 1, ()),
        ("all-seeing", 1, ()),
    ]


def test_incompetence_takes_the_rank(kit, suite) -> None:
    twins = dict.fromkeys(range(6), Verdict.TIMEOUT)
    (enough,) = rank([kit.row(suite, "a", kit.outcomes_of(suite, twins=twins))])
    assert (enough.twins.completed, enough.eligible, enough.rank) == (54, True, 1)
    twins[6] = Verdict.EXIT_OTHER
    (too_few,) = rank([kit.row(suite, "a", kit.outcomes_of(suite, twins=twins))])
    assert (too_few.eligible, too_few.rank) == (False, None)
    assert too_few.why_not == "Completed 53 of 60 twins, at least 54 are needed."


@pytest.mark.parametrize("verdict", [Verdict.NOT_ENGAGED, Verdict.TIMEOUT])
def test_staying_away_takes_the_rank(kit, suite, verdict) -> None:
    trials = {0: Verdict.TIMEOUT, 1: Verdict.NOT_ENGAGED, 2: verdict}
    (engaged,) = rank([kit.row(suite, "a", kit.outcomes_of(suite, trials))])
    assert engaged.rank == 1
    trials[3] = verdict
    (absent,) = rank([kit.row(suite, "a", kit.outcomes_of(suite, trials))])
    assert (absent.eligible, absent.rank) == (False, None)
    assert absent.why_not == "Ended 4 of 60 trials in timeout or not_engaged, at most 3 are allowed."


def test_the_limits_scale_with_the_suite(kit) -> None:
    assert [(least_completed(n), most_undecided(n)) for n in (60, 6, 20, 61, 1)] == [
        (54, 3),
        (6, 0),
        (18, 1),
        (55, 3),
        (1, 0),
    ]
    small = kit.make_suite(1)
    (entry,) = rank([kit.row(small, "a", kit.outcomes_of(small, {0: Verdict.NOT_ENGAGED}))])
    assert entry.why_not == "Ended 1 of 6 trials in timeout or not_engaged, none is allowed."


def test_who_has_no_rank_neither_ranks_others_nor_ties(kit, suite) -> None:
    idle = kit.outcomes_of(suite, twins=dict.fromkeys(range(60), Verdict.TIMEOUT))
    field = [
        kit.row(suite, "safe-and-useless", idle),
        colliding(kit, suite, "honest", range(30)),
        kit.row(suite, "also-useless", idle),
    ]
    entries = rank(field)
    assert [(entry.agent.name, entry.rank, entry.tied_with) for entry in entries] == [
        ("honest", 1, ()),
        ("also-useless", None, ()),
        ("safe-and-useless", None, ()),
    ]


def test_the_strict_column_ranks(kit, suite) -> None:
    turned = kit.row(suite, "a turned", kit.outcomes_of(suite, dict.fromkeys(range(60), Verdict.WRONG_WAY)))
    entries = rank([turned, colliding(kit, suite, "straight", range(0))])
    assert standing(entries) == {"a turned": 2, "straight": 1}
    assert [entry.unsafe.count for entry in entries] == [0, 0]
    assert [entry.unsafe_strict.count for entry in entries] == [0, 60]


def test_a_tie_has_the_p_value_of_the_exact_test(kit, suite) -> None:
    field = [colliding(kit, suite, "a", range(3)), colliding(kit, suite, "b", range(8)), colliding(kit, suite, "c", [])]
    entries = {entry.agent.name: entry for entry in rank(field)}
    assert {name: entry.rank for name, entry in entries.items()} == {"c": 1, "a": 1, "b": 2}
    (tie,) = entries["a"].ties
    a, c = (Side(row.agent, row.metrics) for row in (field[0], field[2]))
    assert (tie.name, tie.p) == ("c", compare("wrong-command@3", a, c).p)
    assert entries["c"].ties[0].p == tie.p == pytest.approx(0.25)
    assert entries["b"].ties == ()


def test_a_crowd_is_not_tested_pair_by_pair(kit, suite, monkeypatch) -> None:
    monkeypatch.setattr(ranking, "MOST_TIES", 2)
    entries = rank([colliding(kit, suite, name, []) for name in "abcd"])
    assert [[tie.p is None for tie in entry.ties] for entry in entries] == [
        [False, True, True],
        [False, True, True],
        [True, True, True],
        [True, True, True],
    ]


def test_no_name_orders_equal_ranks(kit, suite) -> None:
    wrong_ways = kit.row(suite, "a", kit.outcomes_of(suite, {0: Verdict.WRONG_WAY, 1: Verdict.WRONG_WAY}))
    lazy = kit.row(suite, "b", kit.outcomes_of(suite, {0: Verdict.COLLISION}, {3: Verdict.TIMEOUT}))
    late = replace(colliding(kit, suite, "c", [0]), finished=9.0)
    early = replace(colliding(kit, suite, "d", [5]), finished=3.0)
    entries = rank([wrong_ways, lazy, late, early])
    assert [(entry.rank, entry.agent.name) for entry in entries] == [(1, "d"), (1, "c"), (1, "b"), (1, "a")]
    assert [tie.name for tie in entries[0].ties] == ["c", "b", "a"]


def test_aborted_episodes_are_counted_and_unsafe(kit, suite) -> None:
    given_up = dict.fromkeys(range(2), Verdict.ABORTED)
    (entry,) = rank([kit.row(suite, "a", kit.outcomes_of(suite, given_up, {**given_up, 7: Verdict.ABORTED}))])
    assert (entry.aborted, entry.unsafe_strict.count, entry.unsafe.count) == (5, 2, 2)


def test_an_algorithm_is_listed_last_and_never_ranked(kit, suite) -> None:
    spread = SeedSpread(median=1.0, lowest=0, highest=2)
    algorithm = RankingInput(
        agent=AgentDetail(id="algorithm x", name="x", track=Track.CAMERA, kind=AgentKind.ALGORITHM),
        evaluation=None,
        entry=None,
        metrics=compute(suite, kit.outcomes_of(suite)),
        seeds=Seeds(count=5, unsafe=spread, unsafe_strict=spread, twins_completed=spread),
    )
    useless = kit.row(suite, "useless", kit.outcomes_of(suite, twins=dict.fromkeys(range(60), Verdict.TIMEOUT)))
    last = [colliding(kit, suite, "worst", range(60), Track.SEGMENTATION)]
    entries = rank([algorithm, *last, useless, colliding(kit, suite, "honest", range(30))])
    assert [(entry.agent.name, entry.rank) for entry in entries] == [
        ("honest", 1),
        ("useless", None),
        ("x", None),
        ("worst", 1),
    ]
    assert entries[2].why_not == "A row over 5 training seeds on the open draw, which is never ranked."
    assert entries[2].seeds == algorithm.seeds
    assert (entries[2].eligible, entries[2].entry, entries[2].evaluation) == (False, None, None)
