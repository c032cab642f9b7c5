"""Open episodes, and the limits on how many an agent may have."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from wrongturn_protocol import ProblemType
from wrongturn_service.counting import one_less
from wrongturn_service.episodes.open_episode import OpenEpisode, Payer
from wrongturn_service.errors import UnavailableError

_COME_BACK_S = 5


@dataclass(frozen=True, slots=True)
class Most:
    """How many episodes somebody may have open."""

    open: int
    practice: int


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits on open episodes."""

    evaluation: int
    """Episodes of one evaluation."""
    agent: Most
    """Episodes of one agent, or of the runner of a submission."""
    owner: Most
    """Episodes of all agents of one owner."""
    address: Most
    """Episodes that one address has begun."""


class Registry:
    """Open episodes by id. An episode counts from :meth:`reserve` on, before it is open."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._open: dict[str, OpenEpisode] = {}
        self._all: Counter[str] = Counter()
        """Open episodes by holder, owner and address. An id never looks like an address."""
        self._practice: Counter[str] = Counter()

    def __len__(self) -> int:
        return len(self._open)

    def __iter__(self) -> Iterator[OpenEpisode]:
        """Iterate over the episodes that are open now."""
        return iter(list(self._open.values()))

    def get(self, episode_id: str) -> OpenEpisode | None:
        """Return an open episode, or None."""
        return self._open.get(episode_id)

    def of(self, evaluation_id: str) -> list[OpenEpisode]:
        """Return the open episodes of an evaluation."""
        return [episode for episode in self if episode.evaluation == evaluation_id]

    @property
    def held(self) -> int:
        """Number of open episodes that have a simulator."""
        return sum(episode.simulator is not None for episode in self)

    def count(self, holder: str) -> int:
        """Return how many episodes somebody drives, with those that are just being opened."""
        return self._all[holder]

    def reserve(self, payer: Payer, *, practice: bool) -> None:
        """Count an episode that is about to be opened.

        Raises:
            UnavailableError: The agent, its owner or its address has reached a limit.
        """
        limits = self.limits
        for who, name, most in (
            (payer.holder, "agent", limits.agent),
            (payer.owner, "owner", limits.owner),
            (payer.address, "address", limits.address),
        ):
            if who is not None and practice and self._practice[who] >= most.practice:
                raise _too_many(name, f"{most.practice} practice episodes")
            if who is not None and self._all[who] >= most.open:
                raise _too_many(name, f"{most.open} episodes")
        for who in _names(payer):
            self._all[who] += 1
            if practice:
                self._practice[who] += 1

    def give_back(self, payer: Payer, *, practice: bool) -> None:
        """Take back a reservation."""
        for who in _names(payer):
            one_less(self._all, who)
            if practice:
                one_less(self._practice, who)

    def add(self, episode: OpenEpisode) -> None:
        """Add an open episode that was reserved before."""
        self._open[episode.id] = episode

    def remove(self, episode: OpenEpisode) -> None:
        """Remove a closed episode."""
        del self._open[episode.id]
        self.give_back(episode.payer, practice=episode.practice)


def _names(payer: Payer) -> list[str]:
    return [who for who in (payer.holder, payer.owner, payer.address) if who is not None]


def _too_many(who: str, which: str) -> UnavailableError:
    return UnavailableError(
        ProblemType.RATE_LIMITED,
        f"this {who} has {which} open, which is the limit; finish one or DELETE it",
        retry_after_s=_COME_BACK_S,
        status=429,
        position=1,
    )
