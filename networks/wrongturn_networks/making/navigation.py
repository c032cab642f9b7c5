"""The recipe of ``navigation@1``: CoRL 2017's four tasks under its four conditions, 25 routes each.

Kept from Dosovitskiy et al. (CoRL 2017, section 4 and appendix): tasks, towns, training and new weathers, numbers of
routes, cars and pedestrians, time limits, mean lengths of the routes of each task and town
(:data:`wrongturn_networks.journeys.MEAN_LENGTHS`), and that navigation has the same routes with and without other road
users.

Different: the routes themselves, since the towns were built anew. Routes are drawn for each condition instead of once
for each town, which gives 400 routes instead of 100 that are repeated. A route has one of its condition's weathers in
turn; in CoRL each route was driven in every weather.
"""

import itertools
from collections import Counter
from typing import Final, NamedTuple

from wrongturn_networks.journeys import draw_journey
from wrongturn_networks.loading import load_town
from wrongturn_protocol import CORL_TASKS, TRAINING_WEATHERS, Task, Traffic, Trial, Weather

NEW_WEATHERS: Final = (Weather.WET_CLOUDY_NOON, Weather.SOFT_RAIN_SUNSET)
TRAFFIC: Final = {"Town01": Traffic(vehicles=20, pedestrians=50), "Town02": Traffic(vehicles=15, pedestrians=50)}
"""Other road users of dynamic navigation (CoRL 2017)."""
ROUTES: Final = 25
"""Number of routes of each task under each condition."""
ALIKE: Final = 2
"""Most routes of a cell from one lane to another: few pairs of lanes lie straight ahead of each other."""


class TownWeathers(NamedTuple):
    """A condition: a town and its weathers."""

    town: str
    weathers: tuple[Weather, ...]


CONDITIONS: Final = (
    TownWeathers("Town01", TRAINING_WEATHERS),
    TownWeathers("Town01", NEW_WEATHERS),
    TownWeathers("Town02", TRAINING_WEATHERS),
    TownWeathers("Town02", NEW_WEATHERS),
)
"""Training, new weather, new town, new weather and town."""


def navigation(first_seed: int) -> list[Trial]:
    """Draw all trials, ordered by condition and task.

    Args:
        first_seed: seed of the first route; each cell has a thousand seeds of its own.
    """
    trials: list[Trial] = []
    for number, (condition, task) in enumerate(itertools.product(CONDITIONS, CORL_TASKS)):
        # Dynamic navigation uses the seeds of navigation, so it has the same routes.
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
