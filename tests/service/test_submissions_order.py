"""Whose submission is next: fair between owners, and the same whatever order the questions come in."""

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from wrongturn_service.storage.models import SubmissionRow
from wrongturn_service.submissions.order import in_turn, next_one


def waiting(name: str, owner: str, seq: int) -> SubmissionRow:
    return SubmissionRow(id=name, owner_id=owner, seq=seq)


OWNERS = ["ann", "ben", "cid", "dan"]


@st.composite
def lines(draw: st.DrawFn, least: int = 0) -> list[SubmissionRow]:
    owners = draw(st.lists(st.sampled_from(OWNERS), min_size=least, max_size=30))
    return [waiting(f"s{seq}", owner, seq) for seq, owner in enumerate(owners, 1)]


counts = st.dictionaries(st.sampled_from(OWNERS), st.integers(0, 5))
turns = st.permutations(OWNERS).flatmap(
    lambda owners: st.integers(0, len(owners)).map(
        lambda known: {owner: turn for turn, owner in enumerate(owners[:known], 1)}
    )
)


def test_among_owners_with_as_many_running_the_one_served_longest_ago_is_next() -> None:
    line = [waiting("a", "ann", 1), waiting("b", "ben", 2), waiting("c", "cid", 3)]
    assert next_one(line, {}, {"ann": 9, "ben": 7, "cid": 8}) == line[1]
    assert next_one(line, {}, {"ann": 9, "ben": 7}) == line[2]  # never served
    assert next_one(line, {"cid": 1}, {"ann": 9, "ben": 7}) == line[1]


@given(lines(least=1), counts, turns)
def test_the_next_owner_has_the_fewest_and_its_first_submission_goes(line, running, served) -> None:
    chosen = next_one(line, running, served)
    assert chosen is not None
    assert running.get(chosen.owner_id, 0) == min(running.get(one.owner_id, 0) for one in line)
    assert chosen.seq == min(one.seq for one in line if one.owner_id == chosen.owner_id)


@given(lines(), turns, st.integers(1, 5))
def test_while_two_owners_wait_neither_gets_more_than_one_turn_ahead(line, served, slots) -> None:
    ordered = in_turn(line, [], served, slots)
    left = Counter(one.owner_id for one in line)
    got: Counter[str] = Counter()
    for one in ordered:
        got[one.owner_id] += 1
        left[one.owner_id] -= 1
        both = [owner for owner in OWNERS if left[owner]]
        for owner in both:
            # Whoever still waits has had as many turns as anybody else, or one less.
            assert got[owner] >= got[one.owner_id] - 1


@given(lines(), st.lists(st.sampled_from(OWNERS), max_size=4), turns, st.integers(1, 5))
def test_the_whole_order_is_one_next_after_the_other(line, running, served, slots) -> None:
    left, places, turns_of, expected = list(line), list(running), dict(served), []
    while left:
        del places[: max(0, len(places) - slots + 1)]
        one = next_one(left, Counter(places), turns_of)
        assert one is not None
        left.remove(one)
        expected.append(one)
        turns_of[one.owner_id] = max(turns_of.values(), default=0) + 1
        places.append(one.owner_id)
    assert in_turn(line, running, served, slots) == expected
