"""Journeys that are neither trained on nor in any suite: which checkpoint is kept is decided by them."""

from dataclasses import dataclass
from typing import Any

from wrongturn_agents.training.config import TRAINING_WEATHERS
from wrongturn_agents.training.drive import Driver, drive_all
from wrongturn_networks import draw_journey, load_town
from wrongturn_protocol import Task, Trial, Verdict, Weather

_SEEDS = 2**40
"""Theirs begin here, far above the suites'."""


def held_out_journeys(count: int, town: str = "Town01") -> list[Trial]:
    """CoRL 2017's navigation, without other traffic, in the training weathers in turn."""
    weathers = [Weather(weather) for weather in TRAINING_WEATHERS]
    return [
        draw_journey(load_town(town), Task.NAVIGATION, _SEEDS + i, weather=weathers[i % len(weathers)])
        for i in range(count)
    ]


@dataclass(frozen=True)
class Evaluation:
    """Of an agent on held-out journeys."""

    journeys: int
    success: float
    """Share that reached their goal in time."""
    clean: float
    """Share that did so without any infraction."""
    reward: float
    """Mean sum of the paper's reward."""

    @property
    def rank(self) -> tuple[float, float]:
        """What the best has most of: successes; among equals, reward."""
        return self.success, self.reward

    @classmethod
    def of(cls, model: Driver, trials: list[Trial], **options: Any) -> "Evaluation":
        """Drive them; the options are :func:`~wrongturn_agents.training.drive.drive_all`'s."""
        driven = drive_all(model, trials, **options)
        arrived = [one for one in driven if one.outcome is not None and one.outcome.verdict is Verdict.ARRIVED]
        clean = [one for one in arrived if one.outcome and one.outcome.journey and one.outcome.journey.clean]
        count = max(1, len(driven))
        return cls(
            journeys=len(driven),
            success=len(arrived) / count,
            clean=len(clean) / count,
            reward=sum(one.reward for one in driven) / count,
        )
