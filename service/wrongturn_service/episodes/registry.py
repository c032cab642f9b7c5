"""Open episodes, and the limits on how many an agent may have."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from wrongturn_protocol import ProblemType
from wrongturn_service.counting import one_less
from wrongturn_service.episodes.open_episode import OpenEpisode
from wrongturn_service.errors import UnavailableError

_COME_BACK_S = 5


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits on open episodes.

    Attributes:
        evaluation: Episodes of one evaluation.
        practice: Practice episodes of one agent.
        agent: All episodes of one agent.
    """

    evaluation: int
    practice: int
    agent: int


class Registry:
    """Open episodes by id. An episode counts from :meth:`reserve` on, before it is open."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._open: dict[str, OpenEpisode] = {}
        self._holders: Counter[str] = Counter()
        self._practising: Counter[str] = Counter()

    def __len__(self) -> int:
        return len(self._open)

    def __iter__(self) -> Iterator[OpenEpisode]:
        """Iterate over the episodes that are open now."""
        return iter(list(self._open.values()))

    def get(self, episode_id: str) -> OpenEpisode | None:
        """Return an open episode, or None."""
        return self._open.get(episode_id)

    @property
    def held(self) -> int:
        """Number of open episodes that have a simulator."""
        return sum(episode.simulator is not None for episode in self._open.values())

    def count(self, holder: str) -> int:
        """Return how many episodes somebody drives, with those that are just being opened."""
        return self._holders[holder]

    def reserve(self, holder: str, *, practice: bool) -> None:
        """Count an episode that is about to be opened.

        Raises:
            UnavailableError: The agent has reached a limit.
        """
        if practice and self._practising[holder] >= self.limits.practice:
            raise _too_many(f"{self.limits.practice} practice episodes")
        if self._holders[holder] >= self.limits.agent:
            raise _too_many(f"{self.limits.agent} episodes")
        self._holders[holder] += 1
        if practice:
            self._practising[holder] += 1

    def give_back(self, holder: str, *, practice: bool) -> None:
        """Take back a reservation."""
        one_less(self._holders, holder)
        if practice:
            one_less(self._practising, holder)

    def add(self, episode: OpenEpisode) -> None:
        """Add an open episode that was reserved before."""
        self._open[episode.id] = episode

    def remove(self, episode: OpenEpisode) -> None:
        """Remove a closed episode."""
        del self._open[episode.id]
        self.give_back(episode.holder, practice=episode.practice)


def _too_many(which: str) -> UnavailableError:
    return UnavailableError(
        ProblemType.RATE_LIMITED,
        f"this agent has {which} open, which is the limit; finish one or DELETE it",
        retry_after_s=_COME_BACK_S,
        status=429,
        position=1,
    )
