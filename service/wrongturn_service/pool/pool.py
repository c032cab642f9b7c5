"""What the service asks of simulators, whoever runs them: this machine's processes, or a cluster's actors.

::

    SimulatorError
    ├── SimulatorsBusyError       every slot is taken
    ├── SimulatorStartError       no simulator could be started
    ├── SimulatorDiedError        it ended, hung or broke: replay the episode in another one
    └── EpisodeRefusedError       the trial cannot be driven as asked: the caller's mistake
"""

import asyncio
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

from wrongturn_protocol import Outcome, Track
from wrongturn_service.pool.actions import ACTION, Action
from wrongturn_service.pool.screen import Shown
from wrongturn_service.wire import Wire

if TYPE_CHECKING:
    from wrongturn_service.pool.loan import Loan, Returned


def replay_s(actions: bytes) -> float:
    """Seconds that a simulator gets to repeat actions, on top of those for any call: a journey has thousands.

    Args:
        actions: little-endian float32 [n, 3].
    """
    return 0.02 * (len(actions) // ACTION.size)


class SimulatorError(Exception):
    """Anything that concerns simulators."""


class SimulatorsBusyError(SimulatorError):
    """Every slot is taken, or no simulator is ready yet."""

    def __init__(self, message: str, position: int = 1) -> None:
        super().__init__(message)
        self.position = position
        """How many simulators have to become free, or ready, until it is the caller's turn."""


class SimulatorStartError(SimulatorError):
    """No simulator could be started; the message says why."""


class SimulatorDiedError(SimulatorError):
    """The simulator ended, hung or broke."""


class EpisodeRefusedError(SimulatorError):
    """The trial cannot be driven as asked."""

    def __init__(self, name: str, message: str) -> None:
        super().__init__(message)
        self.name = name
        """The error's class in the simulation."""


@dataclass(frozen=True, slots=True)
class Final:
    """What is left of an episode at its end."""

    outcome: Outcome
    steps: int
    trajectory: bytes
    """Canonical JSON."""
    trajectory_sha256: str
    actions_sha256: str


@dataclass(slots=True)
class Frame:
    """What a simulator shows after a reset or a step. Nobody changes it: to have that checked takes too long."""

    observation: bytes | Shown
    """Encoded for the wire."""
    reward: float
    terminated: bool
    truncated: bool
    final: Final | None


class Simulator(ABC):
    """One simulation, which drives one episode at a time."""

    @property
    @abstractmethod
    def dead(self) -> bool:
        """Whether it is gone; what it drove has to be replayed elsewhere."""

    @abstractmethod
    async def reset(self, trial: str, track: Track, actions: bytes, wire: Wire) -> Frame:
        """Begin an episode, and repeat actions that were taken before.

        Args:
            trial: JSON of Trial.
            track: what is observed.
            actions: little-endian float32 [n, 3].
            wire: how the observation is encoded.

        Returns:
            What it shows after the last of the actions.

        Raises:
            SimulatorDiedError, EpisodeRefusedError.
        """

    @abstractmethod
    async def step(self, action: Action, wire: Wire) -> Frame:
        """One decision. Raises SimulatorDiedError."""

    def begin_step(self, action: Action, wire: Wire) -> "asyncio.Future[Frame]":
        """The same without a task, where that is possible; not to be cancelled."""
        return asyncio.ensure_future(self.step(action, wire))

    @property
    def lends(self) -> bool:
        """Whether a client's connection can be lent to it now."""
        return False

    def lend(self, loan: "Loan") -> "asyncio.Future[Returned]":
        """Let it answer the steps that come on a connection; nothing else may be asked of it until that is returned.

        Args:
            loan: what is lent, where :attr:`lends` says that it can be.

        Returns:
            What comes of it, also where the simulator dies of it; not to be cancelled.
        """
        raise NotImplementedError

    def recall(self) -> None:
        """Have what is lent returned soon; where nothing is, nothing happens."""
        raise NotImplementedError

    @abstractmethod
    async def abort(self) -> Final:
        """End the episode as ``aborted``. Raises SimulatorDiedError."""


class Pool(ABC):
    """A bounded number of simulators."""

    @abstractmethod
    async def start(self) -> None:
        """Have a first one ready. Raises SimulatorStartError."""

    @abstractmethod
    async def stop(self) -> None:
        """End all of them."""

    @abstractmethod
    async def acquire(self, town: str, *, wait: bool = False) -> Simulator:
        """A simulator for one's own, best one that has the town loaded.

        Args:
            town: what it will drive in.
            wait: until one is free, instead of refusing.

        Raises:
            SimulatorsBusyError, SimulatorStartError.
        """

    @abstractmethod
    async def release(self, simulator: Simulator) -> None:
        """Give a simulator back, dead or alive."""

    @property
    @abstractmethod
    def slots(self) -> int:
        """Simulators at most."""

    @property
    @abstractmethod
    def running(self) -> int:
        """Simulators that are there, or about to be."""

    @property
    def idle(self) -> int:
        """Simulators that are ready and nobody has."""
        return self.running - self.busy

    @property
    def waiting(self) -> int:
        """Calls that wait for a simulator."""
        return 0

    @property
    def failure(self) -> str | None:
        """Why the last simulator that was to be started did not start; None where it did."""
        return None

    def memory(self) -> int:
        """Bytes of memory that the simulators have, what they share counted once; takes a while to find out."""
        return 0

    @property
    @abstractmethod
    def busy(self) -> int:
        """Simulators that somebody has."""
