"""What journeys came to: success, cleanness and infractions by task and condition, as CoRL 2017 has them."""

import math
from collections import defaultdict
from collections.abc import Sequence

from wrongturn_protocol import (
    Condition,
    Infractions,
    NavigationCount,
    NavigationMetrics,
    Outcome,
    Task,
    Trial,
    Verdict,
)
from wrongturn_service.evaluation.statistics import wilson

Driven = Sequence[tuple[Trial, Outcome]]
"""Journeys and what each came to."""


def is_success(outcome: Outcome) -> bool:
    """Whether a journey reached its goal in time."""
    return outcome.verdict is Verdict.ARRIVED


def is_clean(outcome: Outcome) -> bool:
    """Whether it did so without any infraction."""
    return is_success(outcome) and outcome.journey is not None and outcome.journey.clean


def navigation_metrics(driven: Driven) -> NavigationMetrics:
    """Count journeys by task and condition.

    Args:
        driven: one at least, each with its journey.
    """
    cells: dict[tuple[Task, Condition], list[tuple[Trial, Outcome]]] = defaultdict(list)
    for trial, outcome in driven:
        assert trial.journey is not None
        cells[trial.journey.task, Condition.of(trial.town, trial.weather)].append((trial, outcome))
    return NavigationMetrics(
        total=count(driven),
        table={
            task: {condition: count(cells[task, condition]) for condition in Condition if (task, condition) in cells}
            for task in Task
            if any(found is task for found, _ in cells)
        },
    )


def count(driven: Driven) -> NavigationCount:
    """Count some journeys, one at least.

    An episode that ended without any simulator, which nobody can say more of, has driven no way.
    """
    outcomes = [outcome for _, outcome in driven]
    journeys = [outcome.journey for outcome in outcomes if outcome.journey is not None]
    success = sum(map(is_success, outcomes))
    # fsum is exact, so that the order of the trials has no part in the figures.
    distance = math.fsum(journey.distance for journey in journeys) / 1000
    return NavigationCount(
        episodes=len(outcomes),
        success=success,
        clean=sum(map(is_clean, outcomes)),
        rate=success / len(outcomes),
        ci95=wilson(success, len(outcomes)),
        completion=math.fsum(journey.completion for journey in journeys) / len(outcomes),
        distance=distance,
        per_km=None
        if distance <= 0
        else Infractions(
            off_road=sum(journey.off_road for journey in journeys) / distance,
            wrong_lane=sum(journey.wrong_lane for journey in journeys) / distance,
            collisions=sum(journey.collisions for journey in journeys) / distance,
        ),
    )
