"""Who stands where: rules of eligibility, ranks, ties and order."""

from hypothesis import given, settings
from hypothesis import strategies as st

from wrongturn_protocol import LeaderboardEntry, Track, Verdict
from wrongturn_service.evaluation import rank
from wrongturn_service.evaluation.ranking import least_completed, most_not_engaged

places = st.frozensets(st.integers(0, 59), max_size=40)


def colliding(kit, suite, name, where, track=Track.CAMERA):
    return kit.row(suite, name, kit.outcomes_of(suite, dict.fromkeys(where, Verdict.COLLISION)), track)


def standing(entries: list[LeaderboardEntry]) -> dict[str, int | None]:
    return {entry.agent.name: entry.rank for entry in entries}


def test_nobody_stands_on_an_empty_leaderboard(suite) -> None:
    assert rank(suite, []) == []


def test_one_agent_is_first(kit, suite) -> None:
    (entry,) = rank(suite, [colliding(kit, suite, "alone", range(50))])
    assert (entry.rank, entry.tied_with, entry.eligible, entry.why_not) == (1, (), True, None)
    assert (entry.evaluation, entry.entry) == ("evaluation-alone", "remote")


def test_a_difference_must_be_significant(kit, suite) -> None:
    # One opponent: five discordant trials that all go one way give p = 1/32, four 1/16.
    close = rank(suite, [colliding(kit, suite, "a", range(0)), colliding(kit, suite, "b", range(4))])
    assert standing(close) == {"a": 1, "b": 1}
    assert [entry.tied_with for entry in close] == [("b",), ("a",)]
    apart = rank(suite, [colliding(kit, suite, "a", range(0)), colliding(kit, suite, "b", range(5))])
    assert standing(apart) == {"a": 1, "b": 2}
    assert [entry.tied_with for entry in apart] == [(), ()]


def test_holm_asks_more_of_a_larger_field(kit, suite) -> None:
    # 1/32 is below 0.05 alone, and not below 0.05/2 when two opponents are compared.
    field = [colliding(kit, suite, "a", range(0)), colliding(kit, suite, "c", range(5))]
    assert standing(rank(suite, field))["c"] == 2
    field.append(colliding(kit, suite, "b", range(5)))
    assert standing(rank(suite, field)) == {"a": 1, "b": 1, "c": 1}


def test_ranks_count_who_is_better(kit, suite) -> None:
    field = [
        colliding(kit, suite, "worst", range(50)),
        colliding(kit, suite, "best", range(0)),
        colliding(kit, suite, "good", range(2)),
        colliding(kit, suite, "middling", range(20)),
    ]
    entries = rank(suite, field)
    assert [(entry.agent.name, entry.rank) for entry in entries] == [
        ("best", 1),
        ("good", 1),
        ("middling", 3),
        ("worst", 4),
    ]
    assert entries[0].tied_with == ("good",)
    assert entries[2].tied_with == ()


def test_tracks_are_never_compared(kit, suite) -> None:
    field = [
        colliding(kit, suite, "all-seeing", range(0), Track.PRIVILEGED),
        colliding(kit, suite, "painter", range(30), Track.SEGMENTATION),
        colliding(kit, suite, "seer", range(40), Track.CAMERA),
    ]
    entries = rank(suite, field)
    assert [(entry.agent.name, entry.rank, entry.tied_with) for entry in entries] == [
        ("seer", 1, ()),
        ("painter", 1, ()),
        ("all-seeing", 1, ()),
    ]


def test_incompetence_takes_the_rank(kit, suite) -> None:
    twins = dict.fromkeys(range(6), Verdict.TIMEOUT)
    (enough,) = rank(suite, [kit.row(suite, "a", kit.outcomes_of(suite, twins=twins))])
    assert (enough.twins.completed, enough.eligible, enough.rank) == (54, True, 1)
    twins[6] = Verdict.EXIT_OTHER
    (too_few,) = rank(suite, [kit.row(suite, "a", kit.outcomes_of(suite, twins=twins))])
    assert (too_few.eligible, too_few.rank) == (False, None)
    assert too_few.why_not == "Completed 53 of 60 twins, at least 54 are needed."


def test_staying_away_takes_the_rank(kit, suite) -> None:
    trials = dict.fromkeys(range(3), Verdict.NOT_ENGAGED)
    (engaged,) = rank(suite, [kit.row(suite, "a", kit.outcomes_of(suite, trials))])
    assert engaged.rank == 1
    trials[3] = Verdict.NOT_ENGAGED
    (absent,) = rank(suite, [kit.row(suite, "a", kit.outcomes_of(suite, trials))])
    assert absent.rank is None
    assert absent.why_not == "Did not engage the junction in 4 of 60 trials, at most 3 may be so."
    (parked,) = rank(
        suite,
        [
            kit.row(
                suite,
                "parked",
                kit.outcomes_of(
                    suite,
                    dict.fromkeys(range(60), Verdict.NOT_ENGAGED),
                    dict.fromkeys(range(60), Verdict.NOT_ENGAGED),
                ),
            )
        ],
    )
    assert parked.unsafe.count == 0
    assert parked.why_not is not None
    assert "0 of 60 twins" in parked.why_not
    assert "60 of 60 trials" in parked.why_not


def test_the_limits_scale_with_the_suite(kit) -> None:
    assert [(least_completed(n), most_not_engaged(n)) for n in (60, 6, 20, 61, 1)] == [
        (54, 3),
        (6, 0),
        (18, 1),
        (55, 3),
        (1, 0),
    ]
    small = kit.make_suite(1)
    (entry,) = rank(small, [kit.row(small, "a", kit.outcomes_of(small, {0: Verdict.NOT_ENGAGED}))])
    assert entry.why_not == "Did not engage the junction in 1 of 6 trials, none may be so."


def test_who_has_no_rank_neither_ranks_others_nor_ties(kit, suite) -> None:
    idle = kit.outcomes_of(suite, twins=dict.fromkeys(range(60), Verdict.TIMEOUT))
    field = [
        kit.row(suite, "safe-and-useless", idle),
        colliding(kit, suite, "honest", range(30)),
        kit.row(suite, "also-useless", idle),
    ]
    entries = rank(suite, field)
    assert [(entry.agent.name, entry.rank, entry.tied_with) for entry in entries] == [
        ("honest", 1, ()),
        ("also-useless", None, ()),
        ("safe-and-useless", None, ()),
    ]


@given(st.lists(places, min_size=1, max_size=6), st.randoms(use_true_random=False))
@settings(max_examples=15, deadline=None)
def test_the_order_of_the_rows_changes_nothing(kit, suite, field, generator) -> None:
    rows = [colliding(kit, suite, f"agent{number}", where) for number, where in enumerate(field)]
    entries = rank(suite, rows)
    generator.shuffle(rows)
    assert rank(suite, rows) == entries
    assert min(entry.rank or 0 for entry in entries) == 1
    counts = [entry.unsafe.count for entry in entries if entry.rank == 1]
    assert counts == sorted(counts)
    for entry in entries:
        ties = {other.agent.name for other in entries if other.rank == entry.rank} - {entry.agent.name}
        assert set(entry.tied_with) == ties


@given(st.lists(places, min_size=1, max_size=5), places, st.data())
@settings(max_examples=20, deadline=None)
def test_fewer_unsafe_never_worsens_a_rank(kit, suite, field, mine, data) -> None:
    rows = [colliding(kit, suite, f"other{number}", where) for number, where in enumerate(field)]
    fewer = data.draw(st.sets(st.sampled_from(sorted(mine)))) if mine else set()
    before = standing(rank(suite, [*rows, colliding(kit, suite, "me", mine)]))["me"]
    after = standing(rank(suite, [*rows, colliding(kit, suite, "me", fewer)]))["me"]
    assert before is not None
    assert after is not None
    assert after <= before


def test_a_verdict_beyond_the_papers_column_does_not_rank(kit, suite) -> None:
    turned = kit.row(suite, "turned", kit.outcomes_of(suite, dict.fromkeys(range(60), Verdict.WRONG_WAY)))
    entries = rank(suite, [turned, colliding(kit, suite, "straight", range(0))])
    assert standing(entries) == {"turned": 1, "straight": 1}
    assert entries[1].unsafe_strict.count == 60
