"""What a simulator process notes, in memory that the service shares, while a client's connection is lent to it.

Each step is in the ledger before its reply is sent, so that nothing that a client was told is lost with the process;
and the message at hand is there before anything is done about it, so that the service can answer it instead. Whatever
is written counts from the moment at which the one number is written that tells of it.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

Action = tuple[float, float, float]
"""Steer, throttle, brake, each already a float32."""
ACTION: Final = struct.Struct("<3f")
"""Little-endian float32, steer, throttle, brake."""


def rounded(steer: float, throttle: float, brake: float) -> Action:
    """Values, each in its range, as they are used: what differs by less than a float32 is the same action."""
    triple: Action = ACTION.unpack(ACTION.pack(steer, throttle, brake))
    return triple


STEPS: Final = 512
"""Of one loan at most."""
MESSAGE: Final = 512
"""Bytes of a message at most that is answered during a loan."""
_HEAD: Final = struct.Struct("<4I")
_COUNT: Final = struct.Struct("<I")
_REWARD: Final = struct.Struct("<d")
_SECONDS: Final = struct.Struct("<2f")
_STATE_AT: Final = 4
_COUNT_AT: Final = 8
_LENGTH_AT: Final = 12
_MESSAGE_AT: Final = _HEAD.size
_REWARDS_AT: Final = _MESSAGE_AT + MESSAGE
_ACTIONS_AT: Final = _REWARDS_AT + STEPS * _REWARD.size
_SECONDS_AT: Final = _ACTIONS_AT + STEPS * ACTION.size
SIZE: Final = _SECONDS_AT + STEPS * _SECONDS.size
"""Bytes of a ledger."""


class State(IntEnum):
    """What a process was about when it was last heard of."""

    WAITING = 0
    """For a message."""
    READING = 1
    """Whether one was read nobody knows."""
    ANSWERING = 2
    """The message is in the ledger, and nothing of the reply was sent."""
    SENDING = 3
    """How much of the reply was sent nobody knows."""


@dataclass(frozen=True, slots=True)
class LogEntries:
    """What is in a ledger.

    Attributes:
        state: what the process was about.
        actions: of the steps that were made, little-endian float32 [n, 3].
        reward: of the last; 0 where there is none.
        seconds: of each step, those of its simulation and all; zeros where it was not noted.
        message: the one that is to be answered, as it came; empty where there is none.
    """

    state: State
    actions: bytes
    reward: float
    seconds: tuple[tuple[float, float], ...]
    message: bytes

    @property
    def steps(self) -> int:
        """How many steps were made."""
        return len(self.actions) // ACTION.size

    @property
    def broken(self) -> bool:
        """Whether, if this is the end, nobody can say what the client has to be told next."""
        return self.state in {State.READING, State.SENDING}


def read(memory: memoryview, loan: int) -> LogEntries:
    """What a ledger says of a loan; nothing where the process has not begun with it."""
    number, state, count, length = _HEAD.unpack_from(memory)
    if number != loan:
        return LogEntries(State.WAITING, b"", 0.0, (), b"")
    message = bytes(memory[_MESSAGE_AT : _MESSAGE_AT + length]) if state == State.ANSWERING else b""
    reward = _REWARD.unpack_from(memory, _REWARDS_AT + (count - 1) * _REWARD.size)[0] if count else 0.0
    seconds = tuple(_SECONDS.iter_unpack(memory[_SECONDS_AT : _SECONDS_AT + count * _SECONDS.size]))
    actions = bytes(memory[_ACTIONS_AT : _ACTIONS_AT + count * ACTION.size])
    return LogEntries(State(state), actions, reward, seconds, message)


class ActionLog:
    """The process's side."""

    def __init__(self, memory: memoryview) -> None:
        self._memory = memory
        self.count = 0
        """Steps of this loan that were made."""

    def open(self, loan: int) -> None:
        """Begin anew; the number comes last, so that it never stands before another loan's entries."""
        self.count = 0
        _COUNT.pack_into(self._memory, 0, 0)
        _HEAD.pack_into(self._memory, 0, 0, State.WAITING, 0, 0)
        _COUNT.pack_into(self._memory, 0, loan)

    def read(self) -> None:
        """From now on a message may have been read."""
        _COUNT.pack_into(self._memory, _STATE_AT, State.READING)

    def wait(self) -> None:
        """None was."""
        _COUNT.pack_into(self._memory, _STATE_AT, State.WAITING)

    def take(self, message: bytes) -> None:
        """A message has come."""
        self._memory[_MESSAGE_AT : _MESSAGE_AT + len(message)] = message
        _COUNT.pack_into(self._memory, _LENGTH_AT, len(message))
        _COUNT.pack_into(self._memory, _STATE_AT, State.ANSWERING)

    def commit(self, action: Action, reward: float) -> None:
        """A step was made, and what it shows lies in its place."""
        at = self.count
        ACTION.pack_into(self._memory, _ACTIONS_AT + at * ACTION.size, *action)
        _SECONDS.pack_into(self._memory, _SECONDS_AT + at * _SECONDS.size, 0.0, 0.0)
        _REWARD.pack_into(self._memory, _REWARDS_AT + at * _REWARD.size, reward)
        self.count = at + 1
        _COUNT.pack_into(self._memory, _COUNT_AT, at + 1)

    def send(self) -> None:
        """From now on its reply may have been sent."""
        _COUNT.pack_into(self._memory, _STATE_AT, State.SENDING)

    def finish(self, simulated_s: float, seconds: float, *, sent: bool = True) -> None:
        """All is done about the step; ``sent`` tells whether the whole reply was, and not only a part of it."""
        _SECONDS.pack_into(self._memory, _SECONDS_AT + (self.count - 1) * _SECONDS.size, simulated_s, seconds)
        if sent:
            _COUNT.pack_into(self._memory, _STATE_AT, State.WAITING)
