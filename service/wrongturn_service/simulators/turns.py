"""The order in which agents get simulators."""

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import TypeVar

_T = TypeVar("_T")


def in_turn(held: Mapping[str, int], waiting: Iterable[tuple[str, _T]]) -> list[_T]:
    """Return waiting calls, the next one first.

    The agent with fewer simulators comes first; each of its own earlier calls counts as a simulator. Among equals the
    earlier call comes first. So an agent that asks for a hundred simulators does not block one that asks for its first.

    Args:
        held: number of simulators that each agent has.
        waiting: agent and call, in order of arrival.
    """
    counted = Counter(held)
    ranked = []
    for agent, call in waiting:
        ranked.append((counted[agent], call))
        counted[agent] += 1
    return [call for _, call in sorted(ranked, key=lambda one: one[0])]  # equals stay in order of arrival
