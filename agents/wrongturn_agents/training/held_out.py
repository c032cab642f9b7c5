"""Journeys that are neither trained on nor in any suite: which checkpoint is kept is decided by them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from wrongturn_agents.training.drive import Drive, Driver, drive_each
from wrongturn_networks import draw_journey, load_town
from wrongturn_protocol import TRAINING_WEATHERS, Task, Trial, Verdict

_SEEDS = 2**40
"""Theirs begin here, far above the suites'."""


def held_out_journeys(count: int, town: str = "Town01") -> list[Trial]:
    """CoRL 2017's navigation, without other traffic, in the training weathers in turn."""
    weathers = TRAINING_WEATHERS
    return [
        draw_journey(load_town(town), Task.NAVIGATION, _SEEDS + i, weather=weathers[i % len(weathers)])
        for i in range(count)
    ]


def shortest(journeys: list[Trial], count: int) -> list[Trial]:
    """Those that the least time is given for, in their order: the longest is what an evaluation waits for."""
    limits = sorted((journey.journey.time_limit if journey.journey else 0.0, i) for i, journey in enumerate(journeys))
    return [journeys[i] for i in sorted(i for _, i in limits[:count])]


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
    def each(
        cls, models: Sequence[Driver], trials: list[Trial], *, stop: Callable[[], bool] = lambda: False, **options: Any
    ) -> "list[Evaluation] | None":
        """Of several agents at once, or None where they were stopped before the end.

        Args:
            models: the agents.
            trials: what each drives.
            stop: give up.
            options: :func:`~wrongturn_agents.training.drive.drive_each`'s.
        """
        stopped = False

        def stopping() -> bool:
            nonlocal stopped
            stopped = stopped or stop()
            return stopped

        driven = drive_each(models, trials, stop=stopping, **options)
        return None if stopped else [cls._of(drives) for drives in driven]

    @classmethod
    def of(cls, model: Driver, trials: list[Trial], **options: Any) -> "Evaluation":
        """Of one agent; the options are :func:`~wrongturn_agents.training.drive.drive_each`'s."""
        return cls._of(drive_each([model], trials, **options)[0])

    @classmethod
    def _of(cls, driven: list[Drive]) -> "Evaluation":
        arrived = [one for one in driven if one.outcome is not None and one.outcome.verdict is Verdict.ARRIVED]
        clean = [one for one in arrived if one.outcome and one.outcome.journey and one.outcome.journey.clean]
        count = max(1, len(driven))
        return cls(
            journeys=len(driven),
            success=len(arrived) / count,
            clean=len(clean) / count,
            reward=sum(one.reward for one in driven) / count,
        )
