"""Promises of the ranks about any field: nobody can buy a place."""

import itertools
from dataclasses import dataclass, replace

from hypothesis import given, settings
from hypothesis import strategies as st

from wrongturn_judge import RankingInput, rank
from wrongturn_judge.ranking import interval
from wrongturn_protocol import AgentDetail, AgentKind, Entry, Metrics, Track
from wrongturn_protocol.intervals import RANK_LEVEL
from wrongturn_protocol.intervals import interval as interval_of

CELLS, IN_CELL = 6, 10
TRIALS = CELLS * IN_CELL


@dataclass(frozen=True)
class Agent:
    """What a rank depends on."""

    name: str
    owner: str
    unsafe: int
    completed: int = TRIALS
    undecided: int = 0
    track: Track = Track.CAMERA
    evenly: bool = False
    """Whether the unsafe trials are spread over the cells, or fill cell by cell."""


def row(agent: Agent) -> RankingInput:
    if agent.evenly:
        cells = [(agent.unsafe + cell) // CELLS for cell in range(CELLS)]
    else:
        cells = [min(IN_CELL, max(0, agent.unsafe - IN_CELL * cell)) for cell in range(CELLS)]
    marks = {str(cell): {"": (count, IN_CELL)} for cell, count in enumerate(cells)}
    count = {"count": agent.unsafe, "trials": TRIALS, "rate": agent.unsafe / TRIALS, "ci95": interval_of(marks)}
    return RankingInput(
        agent=AgentDetail(
            id=f"id {agent.name}", name=agent.name, track=agent.track, kind=AgentKind.SUBMITTED, owner=agent.owner
        ),
        evaluation=agent.name,
        entry=Entry.REMOTE,
        metrics=Metrics.model_validate(
            {
                "unsafe": count,
                "unsafe_strict": {**count, "ci83": interval_of(marks, RANK_LEVEL)},
                "twins": {"unsafe": 0, "completed": agent.completed, "trials": TRIALS},
                "excess_unsafe_rate": None,
                "table": {},
                "reactions": {},
                "verdicts": {"infeasible": {"timeout": agent.undecided}},
                "marks": marks,
            }
        ),
    )


def ranks(field: list[Agent]) -> dict[str, int | None]:
    return {entry.agent.name: entry.rank for entry in rank([row(agent) for agent in field])}


@st.composite
def fields(draw: st.DrawFn, largest: int = 12) -> list[Agent]:
    """Agents of a few owners, most of them eligible."""
    kinds = st.tuples(
        st.sampled_from(["", "A", "B", "C"]),
        st.integers(0, TRIALS),
        st.sampled_from([TRIALS, TRIALS, 54, 53]),
        st.sampled_from([0, 0, 3, 4]),
        st.sampled_from([Track.CAMERA, Track.CAMERA, Track.PRIVILEGED]),
        st.booleans(),
    )
    return [
        Agent(f"agent{place}", *kind) for place, kind in enumerate(draw(st.lists(kinds, min_size=1, max_size=largest)))
    ]  # type: ignore[misc]


@given(fields(), st.randoms(use_true_random=False))
@settings(max_examples=40)
def test_the_order_of_the_rows_changes_nothing(field, generator) -> None:
    rows = [row(agent) for agent in field]
    entries = rank(rows)
    generator.shuffle(rows)
    assert rank(rows) == entries
    for entry in entries:
        same = [other for other in entries if (other.rank, other.agent.track) == (entry.rank, entry.agent.track)]
        ties = {other.agent.name for other in same} - {entry.agent.name}
        assert set(entry.tied_with) == (set() if entry.rank is None else ties)


@given(fields())
@settings(max_examples=40)
def test_a_rank_counts_other_owners_below(field) -> None:
    """The rule as the documentation words it, without the code's short cut."""
    found = ranks(field)
    eligible = [agent for agent in field if agent.completed >= 54 and agent.undecided <= 3]
    assert {name for name, rank in found.items() if rank is not None} == {agent.name for agent in eligible}
    for agent in eligible:
        low = interval(row(agent).metrics)[0]
        below = {
            other.owner or other.name
            for other in eligible
            if other.track is agent.track
            and other is not agent
            and (not agent.owner or other.owner != agent.owner)
            and interval(row(other).metrics)[1] < low
        }
        assert found[agent.name] == 1 + len(below)


@given(fields(), st.booleans())
@settings(max_examples=40)
def test_who_lies_below_never_stands_behind(field, alone) -> None:
    """And stands before where each agent has an owner of its own."""
    field = [replace(agent, owner="") for agent in field] if alone else field
    found = ranks(field)
    for a, b in itertools.permutations(field, 2):
        mine, theirs = found[a.name], found[b.name]
        comparable = a.track is b.track and mine is not None and theirs is not None
        if comparable and interval(row(a).metrics)[1] < interval(row(b).metrics)[0]:
            assert mine < theirs if alone else mine <= theirs


@given(fields(), fields(largest=6))
@settings(max_examples=40)
def test_more_agents_move_nobody_up(field, more) -> None:
    """Whoever enters, clone or not, of the same owner or another."""
    before = ranks(field)
    after = ranks([*field, *(replace(agent, name=f"new {agent.name}") for agent in more)])
    for name, rank_before in before.items():
        rank_after = after[name]
        assert (rank_before is None) == (rank_after is None)
        assert rank_before is None or (rank_after is not None and rank_after >= rank_before)


@given(fields(), st.data(), st.integers(1, 6))
@settings(max_examples=40)
def test_clones_of_the_same_owner_change_nobodys_rank(field, data, copies) -> None:
    named = [replace(agent, owner=agent.owner or agent.name) for agent in field]
    original = data.draw(st.sampled_from(named))
    clones = [replace(original, name=f"clone{number}") for number in range(copies)]
    after = ranks([*named, *clones])
    assert {agent.name: after[agent.name] for agent in named} == ranks(named)
    assert all(after[clone.name] == after[original.name] for clone in clones)


@given(fields(), st.lists(st.integers(0, TRIALS), min_size=1, max_size=4))
@settings(max_examples=40)
def test_new_agents_of_an_owner_leave_its_others_where_they_are_and_cost_anybody_else_one_place(field, counts) -> None:
    before = ranks(field)
    after = ranks([*field, *(Agent(f"new{number}", "A", count) for number, count in enumerate(counts))])
    for agent in field:
        rank_before, rank_after = before[agent.name], after[agent.name]
        if rank_before is None or rank_after is None:
            assert rank_before is rank_after
        elif agent.owner == "A":
            assert rank_after == rank_before
        else:
            assert rank_after - rank_before in (0, 1)


@given(fields(), st.data())
@settings(max_examples=40)
def test_fewer_unsafe_never_worsens_a_rank(field, data) -> None:
    me = data.draw(st.sampled_from(field))
    fewer = data.draw(st.integers(0, me.unsafe))
    before = ranks(field)[me.name]
    after = ranks([replace(agent, unsafe=fewer) if agent is me else agent for agent in field])[me.name]
    assert (before is None) == (after is None)
    assert before is None or (after is not None and after <= before)
