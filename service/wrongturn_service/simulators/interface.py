"""What the service asks of simulators, whether they are processes of this machine or actors of a cluster.

::

    SimulatorError
    ├── SimulatorsBusyError       every slot is taken
    ├── SimulatorStartError       no simulator could be started
    ├── SimulatorDiedError        it ended, hung or failed: replay the episode in another one
    └── EpisodeRefusedError       the trial cannot be driven as asked: the caller's mistake
"""

import asyncio
from abc import ABC, abstractmethod
from dataclasses import dataclass

from wrongturn_protocol import Outcome, Track
from wrongturn_service.encoding import Encoding
from wrongturn_service.simulators.actions import ACTION, Action
from wrongturn_service.simulators.shared_memory import ObservationView


def replay_s(actions: bytes) -> float:
    """Return the seconds that a simulator gets to repeat actions, on top of those for any call.

    Args:
        actions: little-endian float32 [n, 3]; a journey has thousands.
    """
    return 0.02 * (len(actions) // ACTION.size)


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

    observation: bytes | ObservationView
    """Encoded for the wire."""
    reward: float
    terminated: bool
    truncated: bool
    final: EpisodeEnd | None


class Simulator(ABC):
    """One simulation, which drives one episode at a time."""

    @property
    @abstractmethod
    def dead(self) -> bool:
        """Whether it has ended; its episode has to be replayed in another one."""

    @abstractmethod
    async def reset(self, trial: str, track: Track, actions: bytes, encoding: Encoding) -> StepResult:
        """Begin an episode, repeat actions that were taken before, and return the result of the last one.

        Args:
            trial: JSON of Trial.
            track: what is observed.
            actions: little-endian float32 [n, 3].
            encoding: of the observation.

        Raises:
            SimulatorDiedError, EpisodeRefusedError.
        """

    @abstractmethod
    async def step(self, action: Action, encoding: Encoding) -> StepResult:
        """Drive one decision. Raises SimulatorDiedError."""

    def begin_step(self, action: Action, encoding: Encoding) -> "asyncio.Future[StepResult]":
        """Begin a step, if possible without a task. The future must not be cancelled."""
        return asyncio.ensure_future(self.step(action, encoding))

    @abstractmethod
    async def view(self) -> bytes:
        """Return a picture of the moment for people, as a pixmap. Raises SimulatorDiedError."""

    @abstractmethod
    async def abort(self) -> EpisodeEnd:
        """End the episode as ``aborted``. Raises SimulatorDiedError."""


class SimulatorPool(ABC):
    """A bounded number of simulators."""

    @abstractmethod
    async def start(self) -> None:
        """Make a first simulator ready. Raises SimulatorStartError."""

    @abstractmethod
    async def stop(self) -> None:
        """End all simulators."""

    @abstractmethod
    async def acquire(self, town: str, agent: str) -> Simulator:
        """Return a simulator for the caller alone, preferably one that has the town loaded.

        Args:
            town: where it will drive.
            agent: for whom. Of two calls that wait for a start, that of the agent with fewer simulators comes first.

        Raises:
            SimulatorsBusyError, SimulatorStartError.
        """

    @abstractmethod
    async def release(self, simulator: Simulator) -> None:
        """Give a simulator back, dead or alive."""

    @property
    @abstractmethod
    def slots(self) -> int:
        """Number of simulators that can drive at a time."""

    @property
    @abstractmethod
    def running(self) -> int:
        """Number of simulators that are started or being started."""

    @property
    def idle(self) -> int:
        """Number of simulators that are ready and not acquired."""
        return self.running - self.busy

    @property
    def failure(self) -> str | None:
        """Why the last start of a simulator failed; None if it did not."""
        return None

    def memory(self) -> int:
        """Return the memory of all simulators, bytes, what they share counted once. Takes a while."""
        return 0

    @property
    @abstractmethod
    def busy(self) -> int:
        """Number of simulators that are acquired."""
