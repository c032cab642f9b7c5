"""Log of the steps that a simulator process answers on a lent connection, in memory that the service shares.

A step is in the log before its reply is sent. So whatever a client has seen is still known when the process dies, and
the service can count steps while the loan lasts.
"""

import struct
from dataclasses import dataclass
from typing import Final

Action = tuple[float, float, float]
"""Steer, throttle, brake, each already a float32."""
ACTION: Final = struct.Struct("<3f")
"""Little-endian float32: steer, throttle, brake."""
STEPS: Final = 1 << 14
"""Steps that fit into the log. Journeys have a few thousand; a full log ends the loan, and another one may follow."""
_ENTRY: Final = struct.Struct("<12sd2f")
"""Action, reward, seconds of the simulation, seconds until the reply is sent."""
_SECONDS: Final = struct.Struct("<f")
_ENTRIES_AT: Final = 8
SIZE: Final = _ENTRIES_AT + STEPS * _ENTRY.size
"""Size of the log, bytes."""
_COUNT_BITS: Final = 32
Seconds = tuple[float, float]
"""Seconds of a step: those of its simulation, and those until its reply is sent; 0 if it is not sent yet."""


def rounded(steer: float, throttle: float, brake: float) -> Action:
    """Return the action as it is driven: values that round to the same float32 are the same action."""
    triple: Action = ACTION.unpack(ACTION.pack(steer, throttle, brake))
    return triple


@dataclass(frozen=True, slots=True)
class LogEntries:
    """Steps of a loan.

    Attributes:
        actions: little-endian float32 [n, 3].
        reward: of the last step; 0 without steps.
        seconds: of each step.
    """

    actions: bytes
    reward: float
    seconds: tuple[Seconds, ...]


class ActionLog:
    """One log; the process writes it, the service reads it."""

    def __init__(self, memory: memoryview) -> None:
        """Use a log.

        Args:
            memory: :data:`SIZE` bytes, writable for the process only.
        """
        self._memory = memory
        # The loan's number and the count share one integer. A memoryview writes it by a single store, so the service
        # never reads half of it.
        self._head = memory[:_ENTRIES_AT].cast("Q")
        self._loan = 0
        self._count = 0

    @property
    def full(self) -> bool:
        """Whether there is no room for another step."""
        return self._count == STEPS

    def begin(self, loan: int) -> None:
        """Begin the log of a loan, without steps."""
        self._loan, self._count = loan << _COUNT_BITS, 0
        self._head[0] = self._loan

    def add(self, action: Action, reward: float, simulated_s: float) -> None:
        """Add a step whose observation is written, and whose reply is not sent yet."""
        at = _ENTRIES_AT + self._count * _ENTRY.size
        _ENTRY.pack_into(self._memory, at, ACTION.pack(*action), reward, simulated_s, 0.0)
        self._count += 1
        self._head[0] = self._loan | self._count

    def sent(self, seconds: float) -> None:
        """Note that the last step's reply is sent, so many seconds after the step came."""
        end = _ENTRIES_AT + self._count * _ENTRY.size
        _SECONDS.pack_into(self._memory, end - _SECONDS.size, seconds)

    def read(self, loan: int, first: int = 0, most: int = STEPS) -> LogEntries:
        """Return steps of a loan; none if the process has not begun with the loan.

        Args:
            loan: its number.
            first: the number of the first step to return.
            most: the number of steps to return at most.
        """
        number, count = divmod(self._head[0], 1 << _COUNT_BITS)
        end = max(first, min(first + most, count if number == loan else 0))
        part = self._memory[_ENTRIES_AT + first * _ENTRY.size : _ENTRIES_AT + end * _ENTRY.size]
        entries = list(_ENTRY.iter_unpack(part))
        return LogEntries(
            b"".join(action for action, *_ in entries),
            entries[-1][1] if entries else 0.0,
            tuple((simulated_s, seconds) for *_, simulated_s, seconds in entries),
        )
