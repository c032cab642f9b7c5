"""A client's connection that is lent to the simulator process that drives its episode.

While an agent does nothing but take steps in one episode, nothing of a step needs the service: its simulator reads the
messages from the connection itself, and answers them there. At whatever else comes, after so many steps or so much
time, and when it is called back, it gives the connection back, with what it has read and not answered. The service
never closes its own end of it, and all that was done is in the ledger (:mod:`wrongturn_service.pool.ledger`), so that
a process that dies takes nothing with it.
"""

from dataclasses import dataclass
from typing import Final

from wrongturn_protocol import Track
from wrongturn_service.pool.actions import Action
from wrongturn_service.pool.pool import Frame
from wrongturn_service.pool.screen import Shown

LOAN_S: Final = 1.0
"""Seconds of a loan at most: so old are figures and leases that are told of meanwhile."""
SENDING_S: Final = 0.5
"""Seconds in which a reply has to be taken, before it is the service that waits for a slow client."""


@dataclass(frozen=True, slots=True)
class Loan:
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
    frame: Frame
    seconds: float


@dataclass(frozen=True, slots=True)
class Returned:
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
    observation: Shown | None = None
    silence_s: float = 0.0
    unread: bytes = b""
    unsent: bytes = b""
    last: LastStep | None = None
    again: bool = False
    broken: bool = False
