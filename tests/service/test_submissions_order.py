"""Whose submission is next: fair between addresses and owners, and the same whatever order the questions come in."""

from collections import Counter
from collections.abc import Mapping

from hypothesis import given
from hypothesis import strategies as st

from wrongturn_service.storage.models import OwnerRow, SubmissionRow
from wrongturn_service.submissions.order import in_turn


def waiting(name: str, owner: str, seq: int) -> SubmissionRow:
    return SubmissionRow(id=name, owner_id=owner, seq=seq, owner=OwnerRow(id=owner, origin=ORIGINS[owner]))


ORIGINS = {"ann": None, "ben": "b", "cid": "c", "dan": None, "eve": "c", "fay": "c"}
"""The address of each owner."""
OWNERS = list(ORIGINS)


def next_one(line: list[SubmissionRow], running: Mapping[str, int], served: Mapping[str, int]) -> SubmissionRow:
    """The next of all that wait, by comparing all."""
    first = {name: row.seq for row in sorted(line, key=lambda row: -row.seq) for name in row.names}
    return min(line, key=lambda row: [(running.get(n, 0), served.get(n, 0), first[n]) for n in row.names] + [row.seq])


def names(owner: str) -> tuple[str, str]:
    return waiting("", owner, 0).names


def each(counts: dict[str, int]) -> Counter[str]:
    """Counts of owners, with those of their addresses."""
    return Counter({name: count for owner, count in counts.items() for name in names(owner)})


@st.composite
def lines(draw: st.DrawFn) -> list[SubmissionRow]:
    owners = draw(st.lists(st.sampled_from(OWNERS), max_size=30))
    return [waiting(f"s{seq}", owner, seq) for seq, owner in enumerate(owners, 1)]


turns = st.permutations(OWNERS).flatmap(
    lambda owners: st.integers(0, len(owners)).map(
        lambda known: {name: turn for turn, owner in enumerate(owners[:known], 1) for name in names(owner)}
    )
)


def test_among_owners_with_as_many_running_the_one_served_longest_ago_is_next() -> None:
    line = [waiting("a", "ann", 1), waiting("b", "ben", 2), waiting("c", "cid", 3)]
    assert in_turn(line, [], each({"ann": 9, "ben": 7, "cid": 8}), 4)[0] == line[1]
    assert in_turn(line, [], each({"ann": 9, "ben": 7}), 4)[0] == line[2]  # never served
    assert in_turn(line, [names("cid")], each({"ann": 9, "ben": 7}), 4)[0] == line[1]


def test_addresses_take_turns_however_many_owners_each_has() -> None:
    line = [waiting(owner, owner, seq) for seq, owner in enumerate(["cid", "eve", "fay", "ben", "ann"], 1)]
    assert [row.id for row in in_turn(line, [], {}, 1)] == ["cid", "ben", "ann", "eve", "fay"]
    assert in_turn(line, [names("cid")], {}, 4)[0] == line[3]


@given(lines(), turns, st.integers(1, 5))
def test_while_two_addresses_wait_neither_gets_more_than_one_turn_ahead(line, served, slots) -> None:
    left = Counter(one.names[0] for one in line)
    got: Counter[str] = Counter()
    for one in in_turn(line, [], served, slots):
        address = one.names[0]
        got[address] += 1
        left[address] -= 1
        # Whoever still waits has had as many turns as anybody else, or one less.
        assert all(got[other] >= got[address] - 1 for other in +left)


@given(lines(), st.lists(st.sampled_from(OWNERS), max_size=4), turns, st.integers(1, 5))
def test_the_whole_order_is_one_next_after_the_other(line, running, served, slots) -> None:
    begun = {name: turn for turn, owner in enumerate(running, 100) for name in names(owner)}
    left, places, turns_of, expected = list(line), [names(owner) for owner in running], {**served, **begun}, []
    while left:
        del places[: max(0, len(places) - slots + 1)]
        one = next_one(left, Counter(name for place in places for name in place), turns_of)
        left.remove(one)
        expected.append(one)
        turns_of |= dict.fromkeys(one.names, max(turns_of.values(), default=0) + 1)
        places.append(one.names)
    assert in_turn(line, [names(owner) for owner in running], {**served, **begun}, slots) == expected
