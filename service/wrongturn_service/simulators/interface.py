"""What the service asks of simulators, whether they are processes of this machine or actors of a cluster.

::

    SimulatorError
    ├── SimulatorsBusyError       every slot is taken
    ├── SimulatorStartError       no simulator could be started
    ├── SimulatorDiedError        it ended, hung or failed: replay the episode in another one
    └── EpisodeRefusedError       the trial cannot be driven as asked: the caller's mistake
"""

import asyncio
import struct
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, TypeVar

from wrongturn_protocol import Outcome, Track
from wrongturn_service.encoding import Encoding

_T = TypeVar("_T")
Action = tuple[float, float, float]
"""Steer, throttle, brake, each a float32: values that round to the same ones are the same action."""
ACTION: Final = struct.Struct("<3f")
"""Little-endian float32: steer, throttle, brake."""


def rounded(steer: float, throttle: float, brake: float) -> Action:
    """Return the action as it is driven."""
    triple: Action = ACTION.unpack(ACTION.pack(steer, throttle, brake))
    return triple


def replay_s(actions: bytes) -> float:
    """Return the seconds that a simulator gets to repeat packed actions, on top of those for any call."""
    return 0.02 * (len(actions) // ACTION.size)


def in_turn(held: Mapping[str, int], waiting: Iterable[tuple[str, _T]]) -> list[_T]:
    """Return waiting calls, the next one first, from pairs of agent and call in order of arrival.

    The agent that has ``held`` fewer simulators comes first; each of its own earlier calls counts as one. Among equals
    the earlier call comes first. So an agent that asks for a hundred does not block one that asks for its first.
    """
    counted = Counter(held)
    ranked = []
    for agent, call in waiting:
        ranked.append((counted[agent], call))
        counted[agent] += 1
    return [call for _, call in sorted(ranked, key=lambda one: one[0])]  # equals stay in order of arrival


class SimulatorError(Exception):
    """Base of all errors of simulators."""


class SimulatorsBusyError(SimulatorError):
    """Every slot is taken, or no simulator is ready yet."""

    def __init__(self, message: str, position: int = 1) -> None:
        super().__init__(message)
        self.position = position
        """Number of simulators that have to become free, or ready, before it is the caller's turn."""


class SimulatorStartError(SimulatorError):
    """No simulator could be started; the message says why."""


class SimulatorDiedError(SimulatorError):
    """The simulator ended, hung or failed."""


class EpisodeRefusedError(SimulatorError):
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


class Simulator(ABC):
    """One simulation, which drives one episode at a time. All calls raise SimulatorDiedError."""

    @property
    @abstractmethod
    def dead(self) -> bool:
        """Whether it has ended; its episode has to be replayed in another one."""

    @abstractmethod
    async def reset(self, trial: str, track: Track, actions: bytes, encoding: Encoding) -> StepResult:
        """Begin an episode, repeat actions that were taken before, and return the result of the last one.

        ``trial`` is JSON of Trial; ``actions`` are little-endian float32 [n, 3]. Raises EpisodeRefusedError.
        """

    @abstractmethod
    def step(self, action: Action, encoding: Encoding) -> "asyncio.Future[StepResult]":
        """Drive one decision. Whoever cancels the future has to give the simulator up."""

    @abstractmethod
    async def view(self) -> bytes:
        """Return a picture of the moment for people, as a pixmap."""

    @abstractmethod
    async def abort(self) -> EpisodeEnd:
        """End the episode as ``aborted``."""


class SimulatorPool(ABC):
    """A bounded number of simulators."""

    slots: int
    """Number of simulators that can drive at a time."""
    failure: str | None = None
    """Why the last start of a simulator failed; None if it did not."""

    @abstractmethod
    async def start(self) -> None:
        """Make a first simulator ready. Raises SimulatorStartError."""

    @abstractmethod
    async def stop(self) -> None:
        """End all simulators."""

    @abstractmethod
    async def acquire(self, town: str, agent: str) -> Simulator:
        """Return a simulator for the caller alone, preferably one that has the town loaded.

        Of two calls that wait for a start, that of the agent with fewer simulators comes first.

        Raises:
            SimulatorsBusyError, SimulatorStartError.
        """

    @abstractmethod
    async def release(self, simulator: Simulator) -> None:
        """Give a simulator back, dead or alive."""

    @property
    @abstractmethod
    def running(self) -> int:
        """Number of simulators that are started or being started."""

    @property
    @abstractmethod
    def busy(self) -> int:
        """Number of simulators that are acquired."""

    @property
    def idle(self) -> int:
        """Number of simulators that are ready and not acquired."""
        return self.running - self.busy

    def memory(self) -> int:
        """Return the memory of all simulators, bytes, what they share counted once. Takes a while."""
        return 0
