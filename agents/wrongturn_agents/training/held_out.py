"""Held-out journeys, which no training and no suite uses: they decide which checkpoint is kept."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from wrongturn_agents.training.drive import DrivenTrial, DrivingModel, drive_trials
from wrongturn_networks import draw_journey, load_town
from wrongturn_protocol import TRAINING_WEATHERS, Task, Trial, Verdict

_SEEDS = 2**40
"""First seed of these journeys, far above the suites' seeds."""


def held_out_journeys(count: int, town: str = "Town01") -> list[Trial]:
    """Draw journeys of CoRL 2017's task *navigation*, without traffic, with the training weathers in turn."""
    weathers = TRAINING_WEATHERS
    return [
        draw_journey(load_town(town), Task.NAVIGATION, _SEEDS + i, weather=weathers[i % len(weathers)])
        for i in range(count)
    ]


def shortest(journeys: list[Trial], count: int) -> list[Trial]:
    """Return the journeys with the shortest time limits, in their order: an evaluation waits for its longest."""
    limits = sorted((journey.journey.time_limit if journey.journey else 0.0, i) for i, journey in enumerate(journeys))
    return [journeys[i] for i in sorted(i for _, i in limits[:count])]


@dataclass(frozen=True)
class Evaluation:
    """Result of an agent on held-out journeys."""

    journeys: int
    """Number of journeys."""
    success: float
    """Share of journeys that reached their goal in time."""
    clean: float
    """Share of journeys that reached it without any infraction."""
    reward: float
    """Mean sum of the paper's reward."""

    @property
    def rank(self) -> tuple[float, float]:
        """Sort key; the best agent has the greatest: more successes, then more reward."""
        return self.success, self.reward

    @classmethod
    def each(
        cls,
        models: Sequence[DrivingModel],
        trials: list[Trial],
        *,
        stop: Callable[[], bool] = lambda: False,
        **options: Any,
    ) -> "list[Evaluation] | None":
        """Evaluate several agents at once; None if ``stop`` ended the drives.

        Args:
            models: the agents.
            trials: journeys that each agent drives.
            stop: called before each decision; True gives up.
            options: arguments of :func:`~wrongturn_agents.training.drive.drive_trials`.
        """
        stopped = False

        def stopping() -> bool:
            nonlocal stopped
            stopped = stopped or stop()
            return stopped

        driven = drive_trials(models, trials, stop=stopping, **options)
        return None if stopped else [cls._of(drives) for drives in driven]

    @classmethod
    def _of(cls, driven: list[DrivenTrial]) -> "Evaluation":
        arrived = [one for one in driven if one.outcome is not None and one.outcome.verdict is Verdict.ARRIVED]
        clean = [one for one in arrived if one.outcome and one.outcome.journey and one.outcome.journey.clean]
        count = max(1, len(driven))
        return cls(
            journeys=len(driven),
            success=len(arrived) / count,
            clean=len(clean) / count,
            reward=sum(one.reward for one in driven) / count,
        )
