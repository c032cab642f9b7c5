"""Recipes of the shipped suites: ``python -m lab.suites`` writes those that are missing and names those that differ.

``navigation@1`` is CoRL 2017's benchmark (Dosovitskiy et al., section 4 and appendix). Kept are its tasks, towns,
training and new weathers, numbers of routes, cars and pedestrians, time limits, mean lengths of the routes of each task
and town (:data:`wrongturn_networks.journeys.MEAN_LENGTHS`), and that navigation has the same routes with and without
other road users. Different are the routes themselves, since the towns were built anew. Routes are drawn for each
condition instead of once for each town, which gives 400 routes instead of 100 that are repeated. A route has one of its
condition's weathers in turn; in CoRL each route was driven in every weather.
"""

import itertools
import sys
from collections import Counter
from collections.abc import Callable
from typing import Final

from wrongturn_networks import draw_journey, load_town
from wrongturn_networks.making.writing_suites import Content, suite_text
from wrongturn_networks.suites import SUITES
from wrongturn_protocol import (
    CORL_TASKS,
    PAPER_TYPES,
    TRAINING_WEATHERS,
    Cell,
    Fault,
    FaultKind,
    Task,
    Traffic,
    Trial,
    Weather,
)

NEW_WEATHERS: Final = (Weather.WET_CLOUDY_NOON, Weather.SOFT_RAIN_SUNSET)
TRAFFIC: Final = {"Town01": Traffic(vehicles=20, pedestrians=50), "Town02": Traffic(vehicles=15, pedestrians=50)}
"""Other road users of dynamic navigation (CoRL 2017)."""
CONDITIONS: Final = tuple(itertools.product(TRAFFIC, (TRAINING_WEATHERS, NEW_WEATHERS)))
"""Town and weathers: training, new weather, new town, new weather and town."""
ROUTES: Final = 25
"""Number of routes of each task under each condition."""
ALIKE: Final = 2
"""Most routes of a cell from one lane to another: few pairs of lanes lie straight ahead of each other."""


def paper_cells(per_cell: int) -> list[Cell]:
    """List the paper's cells, each ``per_cell`` times. An evaluation draws a trial from each."""
    return [
        Cell(town="Town01", junction_type=kind, fault=Fault(kind=fault))
        for fault in (FaultKind.INFEASIBLE, FaultKind.OMISSION)
        for kind in PAPER_TYPES
        for _ in range(per_cell)
    ]


def navigation(first_seed: int) -> list[Trial]:
    """Draw all trials, ordered by condition and task. Each cell has a thousand seeds of its own."""
    trials: list[Trial] = []
    for number, ((town, weathers), task) in enumerate(itertools.product(CONDITIONS, CORL_TASKS)):
        # Dynamic navigation uses the seeds of navigation, so it has the same routes.
        cell = number - (task is Task.NAVIGATION_DYNAMIC)
        trials += _routes(town, weathers, task, first_seed + 1000 * cell)
    return trials


def _routes(town: str, weathers: tuple[Weather, ...], task: Task, seed: int) -> list[Trial]:
    traffic = TRAFFIC[town] if task is Task.NAVIGATION_DYNAMIC else Traffic()
    trials: list[Trial] = []
    drawn: Counter[tuple[str, str | None]] = Counter()
    while len(trials) < ROUTES:
        weather = weathers[len(trials) % len(weathers)]
        trial = draw_journey(load_town(town), task, seed, weather=weather, traffic=traffic)
        seed += 1
        lanes = (trial.approach, trial.journey.goal if trial.journey else None)
        drawn[lanes] += 1
        if drawn[lanes] <= ALIKE:
            trials.append(trial)
    return trials


def unseen_cells() -> list[Cell]:
    """List the paper's cells once in each of ten towns that the secret makes."""
    return [cell.model_copy(update={"town": f"drawn {number}"}) for number in range(10) for cell in paper_cells(1)]


def unseen_navigation() -> list[Cell]:
    """List navigation, without and with other road users, four times in each of ten towns that the secret makes.

    Half of them are in training weathers, which take turns, and half in new ones. *Straight* and *one turn* are left
    out: many drawn towns have no such journey.
    """
    training = itertools.cycle(TRAINING_WEATHERS)
    weathers = [(next(training), next(training), *NEW_WEATHERS) for _ in range(10)]
    return [
        Cell(town=f"drawn {number}", task=task, weather=weather, traffic=traffic)
        for number in range(10)
        for task, traffic in ((Task.NAVIGATION, Traffic()), (Task.NAVIGATION_DYNAMIC, TRAFFIC["Town02"]))
        for weather in weathers[number]
    ]


RECIPES: Final[dict[str, tuple[str, Callable[[], Content]]]] = {
    "navigation@1": ("CoRL 2017's navigation: 4 tasks x 4 conditions x 25 routes", lambda: navigation(3001)),
    "navigation-unseen@1": (
        "Journeys in towns that nobody has seen: the secret makes ten, with 8 in each, 4 of them beside traffic",
        unseen_navigation,
    ),
    "smoke@3": ("Six trials for a first try, one for each of the paper's cells", lambda: paper_cells(1)),
    "wrong-command@3": (
        "The paper's benchmark with fresh trials: 3 junction types x 2 faults x 10 approaches",
        lambda: paper_cells(10),
    ),
    "wrong-command-unseen@1": (
        "Towns that nobody has seen: the secret makes ten, with each of the paper's six cells once in every one",
        unseen_cells,
    ),
}
"""Title of each suite, and its trials or cells."""


def differing() -> list[str]:
    """Write the files that are missing, and return those that differ from their recipe; no suite is overwritten."""
    different = []
    for suite, (title, content) in RECIPES.items():
        file, text = SUITES / f"{suite}.json", suite_text(suite, title, content())
        if not file.exists():
            file.write_text(text, "utf-8")
        elif file.read_text("utf-8") != text:
            different.append(file.name)
    return different


if __name__ == "__main__":
    if found := differing():
        sys.exit(f"differs from its recipe: {', '.join(found)}; give a changed suite a new version")
