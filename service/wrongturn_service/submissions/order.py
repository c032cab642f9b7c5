"""Whose submission is next. Pure functions: the same line gives the same order, whatever the clock says."""

import heapq
from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Waiting:
    """A submission that waits.

    Attributes:
        id: Id of the submission.
        owner: Id of its owner.
        seq: Order of arrival.
    """

    id: str
    owner: str
    seq: int


def next_one(waiting: Iterable[Waiting], running: Mapping[str, int], served: Mapping[str, int]) -> Waiting | None:
    """Return the submission that is next, None if none waits.

    It is one of the owner who has the fewest running; among those, of the one who was served longest ago or never;
    then the one that arrived first.

    Args:
        waiting: The submissions that wait.
        running: How many of each owner run.
        served: The turn in which each owner was last served: 1, 2, 3, … Owners who never were are left out.
    """
    return min(
        waiting,
        key=lambda one: (running.get(one.owner, 0), served.get(one.owner, 0), one.seq),
        default=None,
    )


def in_turn(waiting: Iterable[Waiting], running: Sequence[str], served: Mapping[str, int], slots: int) -> list[Waiting]:
    """Return the waiting submissions in the order in which they will run if no other one arrives.

    Which of those that run ends first is not known; this takes the one that began first.

    Args:
        waiting: The submissions that wait.
        running: Owners of those that run, in the order of their beginnings.
        served: As for :func:`next_one`.
        slots: How many run at a time.
    """
    turns, count, places = dict(served), Counter(running), deque(running)
    lines: dict[str, deque[Waiting]] = {}
    for one in sorted(waiting, key=lambda one: one.seq):
        lines.setdefault(one.owner, deque()).append(one)

    def rank(owner: str) -> tuple[int, int, int]:
        return count[owner], turns.get(owner, 0), lines[owner][0].seq

    # An owner may be in the heap more than once; only its entry with its present rank counts.
    heap = [(rank(owner), owner) for owner in lines]
    heapq.heapify(heap)
    ordered: list[Waiting] = []
    turn = max(turns.values(), default=0)
    while heap:
        while len(places) >= max(1, slots):
            ended = places.popleft()
            count[ended] -= 1
            if lines.get(ended):
                heapq.heappush(heap, (rank(ended), ended))
        ranked, owner = heapq.heappop(heap)
        if not lines[owner] or ranked != rank(owner):
            continue
        ordered.append(lines[owner].popleft())
        turn += 1
        turns[owner] = turn
        count[owner] += 1
        places.append(owner)
        if lines[owner]:
            heapq.heappush(heap, (rank(owner), owner))
    return ordered
