"""Whose submission is next. A pure function: the same line gives the same order, whatever the clock says."""

import heapq
from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence

from wrongturn_service.storage.models import SubmissionRow


def in_turn(
    waiting: Iterable[SubmissionRow], running: Sequence[tuple[str, str]], served: Mapping[str, int], slots: int
) -> list[SubmissionRow]:
    """Return the waiting submissions in the order in which they will run if no other one arrives.

    Addresses take turns, and so do the owners of each. Next is the address that has the fewest running; among those,
    the one that was served longest ago or never; then the one whose submission arrived first. Which of those that run
    ends first is not known; this takes the one that began first.

    ``running`` are the names (:attr:`SubmissionRow.names`) of those that run, in the order of their beginnings.
    ``served`` says in which turn (1, 2, 3, …) each name was last served; names that never were are left out.
    """
    turns, places = dict(served), deque(running)
    count = Counter(name for names in running for name in names)
    lines: dict[str, deque[SubmissionRow]] = {}
    first: dict[str, int] = {}
    # Of each address its owners, and of "" all addresses. A name may be there more than once; only the entry with its
    # present rank counts.
    heaps: dict[str, list[tuple[tuple[int, int, int], str]]] = {"": []}
    for row in sorted(waiting, key=lambda row: row.seq):
        lines.setdefault(row.owner_id, deque()).append(row)
        for name in row.names:
            first.setdefault(name, row.seq)
            heaps.setdefault(name, [])

    def rank(name: str) -> tuple[int, int, int]:
        return count[name], turns.get(name, 0), first[name]

    def push(address: str, owner: str) -> None:
        if lines.get(owner):
            heapq.heappush(heaps[address], (rank(owner), owner))
        if heaps.get(address):
            heapq.heappush(heaps[""], (rank(address), address))

    def pop(group: str) -> str | None:
        while heaps[group]:
            ranked, name = heapq.heappop(heaps[group])
            if ranked == rank(name) and (lines.get(name) or heaps[name]):
                return name
        return None

    for row in {line[0].owner_id: line[0] for line in lines.values()}.values():
        push(*row.names)
    ordered: list[SubmissionRow] = []
    turn = max(turns.values(), default=0)
    while any(heaps.values()):
        while len(places) >= max(1, slots):
            ended = places.popleft()
            count.subtract(ended)
            push(*ended)
        if (address := pop("")) is None:
            break
        if (owner := pop(address)) is None:
            continue
        ordered.append(lines[owner].popleft())
        turn += 1
        for name in (address, owner):
            turns[name] = turn
            count[name] += 1
        places.append((address, owner))
        push(address, owner)
    return ordered
