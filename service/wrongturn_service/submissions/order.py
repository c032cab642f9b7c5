"""Whose submission is next. Pure functions: the same line gives the same order, whatever the clock says.

``running`` says how many of each owner run, ``served`` in which turn (1, 2, 3, …) each owner was last served; owners
who never were are left out.
"""

import heapq
from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence

from wrongturn_service.storage.models import SubmissionRow


def next_one(
    waiting: Iterable[SubmissionRow], running: Mapping[str, int], served: Mapping[str, int]
) -> SubmissionRow | None:
    """Return the submission that is next, None if none waits.

    It is one of the owner who has the fewest running; among those, of the one who was served longest ago or never;
    then the one that arrived first.
    """
    return min(
        waiting, key=lambda row: (running.get(row.owner_id, 0), served.get(row.owner_id, 0), row.seq), default=None
    )


def in_turn(
    waiting: Iterable[SubmissionRow], running: Sequence[str], served: Mapping[str, int], slots: int
) -> list[SubmissionRow]:
    """Return the waiting submissions in the order in which they will run if no other one arrives.

    Which of those that run ends first is not known; this takes the one that began first. ``running`` are their owners,
    in the order of their beginnings.
    """
    turns, count, places = dict(served), Counter(running), deque(running)
    lines: dict[str, deque[SubmissionRow]] = {}
    for row in sorted(waiting, key=lambda row: row.seq):
        lines.setdefault(row.owner_id, deque()).append(row)

    def rank(owner: str) -> tuple[int, int, int]:
        return count[owner], turns.get(owner, 0), lines[owner][0].seq

    # An owner may be in the heap more than once; only its entry with its present rank counts.
    heap = [(rank(owner), owner) for owner in lines]
    heapq.heapify(heap)
    ordered: list[SubmissionRow] = []
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
