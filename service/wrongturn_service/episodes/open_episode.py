"""Open episodes in memory: enough to replay them in another simulator; the rules for their calls, and their number."""

import asyncio
from collections import Counter
from dataclasses import dataclass, field

from wrongturn_protocol import ProblemType, Sight, Trial
from wrongturn_service.encoding import Reply
from wrongturn_service.errors import ConflictError, ForbiddenError, NotFoundError, UnavailableError, too_many
from wrongturn_service.simulators.interface import ACTION, Action, EpisodeEnd
from wrongturn_service.simulators.simulator import Simulator


@dataclass(frozen=True, slots=True)
class Payer:
    """The agent, owner and address whose limits an open episode uses."""

    holder: str
    """Id of who drives it: the agent, or the submission whose runner does."""
    owner: str
    """Id of the agent's owner."""
    address: str | None
    """The address that has begun it. None for a runner, whose address is the service's own."""

    @property
    def names(self) -> tuple[str, str, str]:
        """Address, owner and holder, as limits and queue count. For a runner the owner stands for the address."""
        return f"at {self.address or self.owner}", self.owner, self.holder


@dataclass(eq=False)
class OpenEpisode:
    """An episode that an agent drives."""

    id: str
    payer: Payer
    evaluation: str | None
    """Id of the evaluation, None in practice, which is never scored."""
    trial: Trial
    sight: Sight
    """What its agent is shown."""
    last: Reply
    """The last reply."""
    heard: float
    """When its agent last sent something, by the clock of its lease."""
    counts: bool
    """Whether the evaluation is known to have had a step, so that it counts; true in practice."""
    actions: bytearray = field(default_factory=bytearray)
    """All actions so far, little-endian float32 [n, 3]."""
    simulator: Simulator | None = None
    """None while it is released or dead."""
    origin: str | None = None
    """Id of the episode that this one is a fork of."""
    expected: bytes = b""
    """The origin's actions up to the fork, as ``actions``: no others are taken there."""
    placed: bool = False
    """Whether the episode holds a place of the queue, with or without a simulator."""
    end: EpisodeEnd | None = None
    """The end, once the episode is over."""
    closed: bool = False
    """Whether the episode is stored or given up. From then on only the database knows it."""
    lock: asyncio.Lock = field(default_factory=asyncio.Lock)

    @property
    def seq(self) -> int:
        """Sequence number of the last reply."""
        return self.last.seq

    @property
    def holder(self) -> str:
        """Id of who drives it: the agent, or the submission whose runner does."""
        return self.payer.holder

    @property
    def last_action(self) -> Action | None:
        """Action of the last step, None before the first."""
        if not self.actions:
            return None
        steer, throttle, brake = ACTION.unpack_from(self.actions, len(self.actions) - ACTION.size)
        return steer, throttle, brake

    def check_holder(self, holder: str) -> None:
        """Raise ForbiddenError if another agent drives the episode, or the runner of a submission does."""
        if holder != self.holder:
            raise ForbiddenError(f"episode {self.id} belongs to another agent")

    def check_step(self, seq: int) -> bool:
        """Return True for the next step of an open episode, False for a repeat of the last one.

        Raises:
            ConflictError: The episode is over, or ``seq`` is neither the last number nor the next.
        """
        if seq == self.seq:
            return False
        if self.end is not None:
            raise episode_finished(self.id)
        if seq != self.seq + 1:
            again = f", or {self.seq} with the same action to get that reply again" if self.seq else ""
            raise ConflictError(
                ProblemType.SEQUENCE_GAP,
                f"episode {self.id}: seq is {seq}, but the last reply has {self.seq}; send {self.seq + 1}{again}",
            )
        return True

    def differs(self, action: Action) -> bool:
        """Return whether the next step's action is not the origin's, although the fork is still to come."""
        begin = len(self.actions)
        return begin < len(self.expected) and ACTION.pack(*action) != self.expected[begin : begin + ACTION.size]

    def check_origin(self, action: Action) -> None:
        """Raise ConflictError if the next step :meth:`differs`."""
        if self.differs(action):
            was = ACTION.unpack_from(self.expected, len(self.actions))
            given, stored = (", ".join(f"{value:.9g}" for value in values) for values in (action, was))
            raise ConflictError(
                ProblemType.ACTION_MISMATCH,
                f"episode {self.id}: the agent is not deterministic: at step {self.seq + 1}, before the fork, steer, "
                f"throttle and brake are {given}, and {stored} in {self.origin}; send those, or DELETE the episode",
            )

    def locked_now(self) -> bool:
        """Acquire the lock without waiting and return whether that worked."""
        if self.lock.locked():
            return False
        attempt = self.lock.acquire()
        try:
            attempt.send(None)
        except StopIteration:
            return True
        attempt.close()  # another task was just woken to take it
        return False


class Registry(dict[str, OpenEpisode]):
    """Open episodes by id. An episode counts from :meth:`reserve` on, before it is open."""

    def __init__(self, max_parallel: int, max_open: int) -> None:
        """Create it empty.

        Of one evaluation ``max_parallel`` may be open; of an agent or a runner ``max_open``, of an owner twice as many,
        and of an address four times. Half of these may be practice.
        """
        super().__init__()
        self.max_parallel = max_parallel
        self._max_open = max_open
        self._all: Counter[str] = Counter()
        """Open episodes by address, owner and holder, see :attr:`Payer.names`."""
        self._practice: Counter[str] = Counter()

    def of(self, evaluation_id: str) -> list[OpenEpisode]:
        """Return the open episodes of an evaluation."""
        return [episode for episode in self.values() if episode.evaluation == evaluation_id]

    def count(self, holder: str) -> int:
        """Return how many episodes somebody drives, with those that are just being opened."""
        return self._all[holder]

    def reserve(self, payer: Payer, *, practice: bool) -> None:
        """Count an episode that is about to be opened.

        Raises:
            UnavailableError: The agent, its owner or its address has reached a limit.
        """
        for who, name, factor in zip(payer.names[::-1], ("agent", "owner", "address"), (1, 2, 4), strict=True):
            most = factor * self._max_open
            half = max(1, most // 2)
            if practice and self._practice[who] >= half:
                raise _too_many(name, f"{half} practice episodes")
            if self._all[who] >= most:
                raise _too_many(name, f"{most} episodes")
        self._all.update(payer.names)
        if practice:
            self._practice.update(payer.names)

    def give_back(self, payer: Payer, *, practice: bool) -> None:
        """Take back a reservation, also that of an episode that was opened and is closed now."""
        self._all -= Counter(payer.names)
        if practice:
            self._practice -= Counter(payer.names)


def _too_many(who: str, which: str) -> UnavailableError:
    return too_many(f"this {who} has {which} open, which is the limit; finish one or DELETE it")


def check_view(episode_id: str, evaluation: str | None) -> None:
    """Raise ForbiddenError if an episode is of an evaluation: the view shows more than an agent's track does."""
    if evaluation is not None:
        raise ForbiddenError(f"episode {episode_id} counts, and its view shows what agents may not see; view practice")


def check_same(episode_id: str, seq: int, action: Action, last: Action | None) -> None:
    """Raise ConflictError if a repeated step has another action than the first time."""
    if action != last:
        raise ConflictError(
            ProblemType.ACTION_MISMATCH,
            f"episode {episode_id}: step {seq} was already taken with another action and cannot be changed",
        )


def episode_finished(episode_id: str) -> ConflictError:
    """Return the error for a step after the episode's end."""
    return ConflictError(ProblemType.EPISODE_FINISHED, f"episode {episode_id} is over; ask for the next trial")


def unknown_episode(episode_id: str) -> NotFoundError:
    """Return the error for a call on an episode that does not exist."""
    return NotFoundError(ProblemType.UNKNOWN_EPISODE, f"there is no episode {episode_id[:64]!r}")


def stopping() -> UnavailableError:
    """Return the error for a call that arrives while the service stops."""
    return UnavailableError(ProblemType.SHUTTING_DOWN, "the service is stopping", retry_after_s=5)
