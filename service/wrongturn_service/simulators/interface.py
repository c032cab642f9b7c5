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
from typing import Final

from wrongturn_protocol import Outcome, Track
from wrongturn_service.encoding import Encoding
from wrongturn_service.simulators.action_log import ACTION, Action
from wrongturn_service.simulators.shared_memory import ObservationView

LOAN_S: Final = 1.0
"""Seconds of a loan at most: so old are figures and leases that are told of meanwhile."""
SENDING_S: Final = 0.5
"""Seconds in which a reply has to be taken, before it is the service that waits for a slow client."""


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
class EpisodeEnd:
    """What is left of an episode at its end."""

    outcome: Outcome
    steps: int
    trajectory: bytes
    """Canonical JSON."""
    trajectory_sha256: str
    actions_sha256: str


@dataclass(slots=True)
class StepResult:
    """What a simulator shows after a reset or a step. Nobody changes it: to have that checked takes too long."""

    observation: bytes | ObservationView
    """Encoded for the wire."""
    reward: float
    terminated: bool
    truncated: bool
    final: EpisodeEnd | None


@dataclass(frozen=True, slots=True)
class LoanRequest:
    """What a simulator has to know.

    Attributes:
        handle: the connection's file descriptor.
        episode: its id.
        track: what is observed.
        seq: of its last reply.
        practice: whether rewards are told.
    """

    handle: int
    episode: str
    track: Track
    seq: int
    practice: bool


@dataclass(frozen=True, slots=True)
class LastStep:
    """The step that ended the episode; the service answers it, once it is stored.

    Attributes:
        number: of the message.
        action: what was done.
        frame: what came of it.
        seconds: of the simulation.
    """

    number: int
    action: Action
    frame: StepResult
    seconds: float


@dataclass(frozen=True, slots=True)
class LoanResult:
    """What came of a loan.

    Attributes:
        actions: of the steps that were answered, little-endian float32 [n, 3].
        seconds: of each of them, those of its simulation and all; zeros where nobody knows.
        reward: of the last of them.
        observation: of the last of them; None where there was none.
        silence_s: seconds since the client was heard of.
        unread: what has come and is not answered.
        unsent: what is left of a reply.
        last: the step after them, where it ended the episode.
        again: whether it was only for its length that it ended.
        broken: whether nobody knows what was read, or sent of a reply: the connection is of no more use.
    """

    actions: bytes = b""
    seconds: tuple[tuple[float, float], ...] = ()
    reward: float = 0.0
    observation: ObservationView | None = None
    silence_s: float = 0.0
    unread: bytes = b""
    unsent: bytes = b""
    last: LastStep | None = None
    again: bool = False
    broken: bool = False


class Simulator(ABC):
    """One simulation, which drives one episode at a time."""

    @property
    @abstractmethod
    def dead(self) -> bool:
        """Whether it is gone; what it drove has to be replayed elsewhere."""

    @abstractmethod
    async def reset(self, trial: str, track: Track, actions: bytes, encoding: Encoding) -> StepResult:
        """Begin an episode, and repeat actions that were taken before.

        Args:
            trial: JSON of Trial.
            track: what is observed.
            actions: little-endian float32 [n, 3].
            encoding: how the observation is encoded.

        Returns:
            What it shows after the last of the actions.

        Raises:
            SimulatorDiedError, EpisodeRefusedError.
        """

    @abstractmethod
    async def step(self, action: Action, encoding: Encoding) -> StepResult:
        """One decision. Raises SimulatorDiedError."""

    def begin_step(self, action: Action, encoding: Encoding) -> "asyncio.Future[StepResult]":
        """The same without a task, where that is possible; not to be cancelled."""
        return asyncio.ensure_future(self.step(action, encoding))

    @property
    def lends(self) -> bool:
        """Whether a client's connection can be lent to it now."""
        return False

    def lend(self, loan: LoanRequest) -> "asyncio.Future[LoanResult]":
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
    async def abort(self) -> EpisodeEnd:
        """End the episode as ``aborted``. Raises SimulatorDiedError."""


class SimulatorPool(ABC):
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
