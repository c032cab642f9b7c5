"""What simulators are sent, what they answer, and how they fail."""

import struct
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

from wrongturn_protocol import Outcome

_T = TypeVar("_T")
Place = tuple[str, int | None]
"""A town and the seed of its drawn scenery; None: the scenery that it ships with."""
Action = tuple[float, float, float]
"""Steer, throttle, brake, each a float32: values that round to the same ones are the same action."""
OK: Final = 0
"""First item of a reply to a request that worked."""
REFUSED: Final = 1
"""First item of a reply that refuses a trial."""
FAILED: Final = 2
"""First item of a reply that says that the simulation failed."""
ACTION: Final = struct.Struct("<3f")
"""Little-endian float32: steer, throttle, brake."""


def rounded(steer: float, throttle: float, brake: float) -> Action:
    """Return the action as it is driven."""
    triple: Action = ACTION.unpack(ACTION.pack(steer, throttle, brake))
    return triple


def replay_s(actions: bytes) -> float:
    """Return the seconds that a simulator gets to repeat packed actions, on top of those for any call."""
    return 0.02 * (len(actions) // ACTION.size)


def in_turn(held: Mapping[str, int], waiting: Iterable[tuple[Sequence[str], _T]]) -> list[_T]:
    """Return waiting calls, the next one first, from pairs of names and call in order of arrival.

    The names say whose a call is, the largest group first, such as address, owner and agent. Groups take turns, and so
    do the groups within each: the one that has ``held`` fewer simulators comes first, and each of its own earlier calls
    counts as one. Among equals the earlier call comes first. So a group that asks for a hundred does not block one that
    asks for its first.
    """

    def ordered(calls: list[tuple[int, Sequence[str], _T]], level: int) -> list[tuple[int, Sequence[str], _T]]:
        if not calls or level == len(calls[0][1]):
            return calls
        groups = defaultdict(list)
        for call in calls:
            groups[call[1][level]].append(call)
        ranked = [
            (held.get(name, 0) + turn, call)
            for name, group in groups.items()
            for turn, call in enumerate(ordered(group, level + 1))
        ]
        return [call for _, call in sorted(ranked, key=lambda one: (one[0], one[1][0]))]

    return [call for _, _, call in ordered([(number, *one) for number, one in enumerate(waiting)], 0)]


class SimulatorsBusyError(Exception):
    """Every slot is taken, or no simulator is ready yet."""

    def __init__(self, message: str, position: int = 1) -> None:
        super().__init__(message)
        self.position = position
        """Number of simulators that have to become free, or ready, before it is the caller's turn."""


class SimulatorStartError(Exception):
    """No simulator could be started; the message says why."""


class SimulatorDiedError(Exception):
    """The simulator ended, hung or failed."""


class EpisodeRefusedError(Exception):
    """The trial cannot be driven as asked."""

    def __init__(self, name: str, message: str) -> None:
        super().__init__(message)
        self.name = name
        """Class of the error in the simulation."""


@dataclass(frozen=True, slots=True)
class EpisodeEnd:
    """What remains of an episode that is over."""

    outcome: Outcome
    steps: int
    trajectory: bytes
    """Canonical JSON."""
    trajectory_sha256: str
    actions_sha256: str


@dataclass(slots=True)
class StepResult:
    """Result of a reset or a step. Treat it as frozen: Python's own check takes too long here."""

    observation: bytes
    """Encoded for the wire."""
    reward: float
    terminated: bool
    truncated: bool
    final: EpisodeEnd | None
