"""The episodes that are open, and how many of them are whose."""

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
    """How many episodes may be open.

    Attributes:
        evaluation: of one evaluation.
        practice: of one agent's practice.
        agent: of one agent in all.
    """

    evaluation: int
    practice: int
    agent: int


class Registry:
    """Open episodes by their ids; what is about to be opened counts already."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._open: dict[str, OpenEpisode] = {}
        self._agents: Counter[str] = Counter()
        self._practising: Counter[str] = Counter()

    def __len__(self) -> int:
        return len(self._open)

    def __iter__(self) -> Iterator[OpenEpisode]:
        """All of them, as they are now."""
        return iter(list(self._open.values()))

    def get(self, episode_id: str) -> OpenEpisode | None:
        """One of them."""
        return self._open.get(episode_id)

    @property
    def held(self) -> int:
        """How many have a simulator."""
        return sum(episode.simulator is not None for episode in self._open.values())

    def reserve(self, agent: str, *, practice: bool) -> None:
        """Count one that is about to be opened.

        Raises:
            UnavailableError: the agent has as many as it may.
        """
        if practice and self._practising[agent] >= self.limits.practice:
            raise _too_many(f"{self.limits.practice} practice episodes")
        if self._agents[agent] >= self.limits.agent:
            raise _too_many(f"{self.limits.agent} episodes")
        self._agents[agent] += 1
        if practice:
            self._practising[agent] += 1

    def give_back(self, agent: str, *, practice: bool) -> None:
        """It came to nothing."""
        one_less(self._agents, agent)
        if practice:
            one_less(self._practising, agent)

    def add(self, episode: OpenEpisode) -> None:
        """It is open; it was counted before."""
        self._open[episode.id] = episode

    def remove(self, episode: OpenEpisode) -> None:
        """It is open no more."""
        del self._open[episode.id]
        self.give_back(episode.agent, practice=episode.practice)


def _too_many(which: str) -> UnavailableError:
    return UnavailableError(
        ProblemType.RATE_LIMITED,
        f"{which} of this agent are open, which is as many as may be; finish one, or DELETE it",
        retry_after_s=_COME_BACK_S,
        status=429,
        position=1,
    )
