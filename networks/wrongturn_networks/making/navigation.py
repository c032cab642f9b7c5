"""The recipe of ``navigation@1``: CoRL 2017's four tasks under its four conditions, 25 routes each.

What is kept of Dosovitskiy et al. (CoRL 2017, section 4 and appendix): tasks, towns, training and new weathers, numbers
of routes, cars and pedestrians, time limits, mean lengths of the routes of each task and town
(:data:`wrongturn_networks.journeys.MEAN_LENGTHS`), and that navigation has the same routes with other road users as
without. What is not: its very routes, since the towns were built anew; and the routes are drawn for each condition
instead of one list for each town, so that 400 routes are driven rather than 100 over and over; its weathers (here each
of the condition's in turn, there every route in every weather).
"""

import itertools
from collections import Counter
from typing import Final, NamedTuple

from wrongturn_networks.journeys import draw_journey
from wrongturn_networks.loading import load_town
from wrongturn_protocol import CORL_TASKS, TRAINING_WEATHERS, Task, Traffic, Trial, Weather

NEW_WEATHERS: Final = (Weather.WET_CLOUDY_NOON, Weather.SOFT_RAIN_SUNSET)
TRAFFIC: Final = {"Town01": Traffic(vehicles=20, pedestrians=50), "Town02": Traffic(vehicles=15, pedestrians=50)}
"""Of navigation with other road users, as CoRL 2017 had it."""
ROUTES: Final = 25
"""Of each task under each condition."""
ALIKE: Final = 2
"""A cell has so many routes at most from one lane to another: few pairs of lanes lie straight ahead of each other."""


class TownWeathers(NamedTuple):
    """Where and in what weathers."""

    town: str
    weathers: tuple[Weather, ...]


CONDITIONS: Final = (
    TownWeathers("Town01", TRAINING_WEATHERS),
    TownWeathers("Town01", NEW_WEATHERS),
    TownWeathers("Town02", TRAINING_WEATHERS),
    TownWeathers("Town02", NEW_WEATHERS),
)
"""Training, new weather, new town, both."""


def navigation(first_seed: int) -> list[Trial]:
    """All trials; those of a condition, and therein of a task, stand together.

    Args:
        first_seed: that of the first route tried; each cell has a thousand of its own.
    """
    trials: list[Trial] = []
    for number, (condition, task) in enumerate(itertools.product(CONDITIONS, CORL_TASKS)):
        # Navigation's seeds again for navigation with other road users: the same routes.
        cell = number - (task is Task.NAVIGATION_DYNAMIC)
        trials += _cell(condition, task, first_seed + 1000 * cell)
    return trials


def _cell(condition: TownWeathers, task: Task, seed: int) -> list[Trial]:
    town = load_town(condition.town)
    traffic = TRAFFIC[condition.town] if task is Task.NAVIGATION_DYNAMIC else Traffic()
    trials: list[Trial] = []
    drawn: Counter[tuple[str, str | None]] = Counter()
    while len(trials) < ROUTES:
        weather = condition.weathers[len(trials) % len(condition.weathers)]
        trial = draw_journey(town, task, seed, weather=weather, traffic=traffic)
        seed += 1
        lanes = (trial.approach, trial.journey.goal if trial.journey else None)
        drawn[lanes] += 1
        if drawn[lanes] <= ALIKE:
            trials.append(trial)
    return trials
