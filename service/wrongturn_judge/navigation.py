"""Metrics of journeys by task and condition, as in CoRL 2017: success, clean success and infractions."""

import math
from collections import defaultdict
from collections.abc import Sequence

from wrongturn_judge.intervals import wilson
from wrongturn_protocol import Condition, Infractions, NavigationCount, NavigationMetrics, Outcome, Task, Trial, Verdict

Driven = Sequence[tuple[Trial, Outcome]]
"""Journeys and their outcomes."""


def is_success(outcome: Outcome) -> bool:
    """Return whether a journey reached its goal in time."""
    return outcome.verdict is Verdict.ARRIVED


def is_clean(outcome: Outcome) -> bool:
    """Return whether a journey reached its goal in time and without an infraction."""
    return is_success(outcome) and outcome.journey is not None and outcome.journey.clean


def navigation_metrics(driven: Driven) -> NavigationMetrics:
    """Count journeys, at least one, by task and condition."""
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
    """Return the metrics of journeys, at least one.

    An episode that ended without a simulator counts with a distance of 0.
    """
    outcomes = [outcome for _, outcome in driven]
    journeys = [outcome.journey for outcome in outcomes if outcome.journey is not None]
    success = sum(map(is_success, outcomes))
    # fsum is exact, so the order of the trials does not change the sum.
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
