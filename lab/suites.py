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

from wrongturn_networks import NetworkError, draw_journey, load_town, possible_trials
from wrongturn_networks.disturbances.disturbance import Disturbance
from wrongturn_networks.draws import is_drawn_cell
from wrongturn_networks.faults import available_faults, check_fault, fault_class
from wrongturn_networks.making.writing_suites import Content, suite_text
from wrongturn_networks.suites import SUITES
from wrongturn_protocol import (
    CORL_TASKS,
    PAPER_TYPES,
    TRAINING_WEATHERS,
    Cell,
    Fault,
    FaultKind,
    JunctionType,
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
DISTURBANCES: Final = tuple(kind for kind in available_faults() if issubclass(fault_class(kind), Disturbance))
_APART: Final = {FaultKind.NONE, FaultKind.CONTRADICTION, *DISTURBANCES}
"""Those that are no wrong command, or came after the extended suite."""
FAULTS: Final = tuple(kind for kind in available_faults() if kind not in _APART)
SETTINGS: Final = tuple(itertools.product((TRAINING_WEATHERS, NEW_WEATHERS), (False, True)))
"""Weathers, and whether beside traffic: the settings in which the extended suite has each fault."""
EXTENDED_TOWNS: Final = 16
"""Drawn towns of the extended suite. Six in ten have a crossing, so one draw in a million has none."""
ANY_DRAWN: Final = "drawn 0"
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


def extended_cells() -> list[Cell]:
    """List the paper's cells four times, and then a balanced fraction of all faults, types, towns and settings.

    Each fault meets each type once in each setting: training or new weathers, alone or beside traffic. There its three
    T-junctions are in Town01, in Town02 and in a drawn town, in turn; its crossing is in a drawn town always. Weathers,
    drawn towns and the doses that suites use take turns, too.
    """
    cells = [cell for number in range(len(FAULTS)) for part in range(len(SETTINGS)) for cell in _extended(number, part)]
    # Each round begins one town later, or every second town would have crossings only.
    labels = (f"drawn {(k + k // EXTENDED_TOWNS) % EXTENDED_TOWNS}" for k in itertools.count())
    return paper_cells(4) + [
        cell.model_copy(update={"town": next(labels)}) if is_drawn_cell(cell) else cell for cell in cells
    ]


def _extended(number: int, part: int) -> list[Cell]:
    """Return the cells of a fault in a setting, one for each type of junction that it can be applied to."""
    weathers, beside = SETTINGS[part]
    doses = doses_of(FAULTS[number])

    def cell(place: int, shift: int) -> Cell:
        kind, turn = tuple(JunctionType)[place], place + part + number
        towns = (ANY_DRAWN,) if kind is JunctionType.CROSS else (*TRAFFIC, ANY_DRAWN)
        town = towns[(turn + shift) % len(towns)]
        return Cell(
            town=town,
            junction_type=kind,
            # Doses go down where towns go up, so that each dose meets each town.
            fault=Fault(kind=FAULTS[number], dose=doses[(place - part - number) % len(doses)]),
            weather=weathers[(turn + 2) % len(weathers)],
            traffic=TRAFFIC.get(town, TRAFFIC["Town02"]) if beside else Traffic(),
        )

    types = [k for k, kind in enumerate(JunctionType) if kind is not JunctionType.CROSS or _applies(cell(k, 0))]
    # Some faults need a longer lane than a type has in a town: then all towns change places.
    shifts = ([cell(place, shift) for place in types] for shift in range(3))
    return next(cells for cells in shifts if all(map(_applies, cells)))


def doses_of(kind: FaultKind) -> tuple[float | None, ...]:
    """Return the doses of a fault that suites use."""
    dose = fault_class(kind).dose
    return (None,) if dose is None else dose.suites


def _applies(cell: Cell) -> bool:
    """Return whether a cell's fault can be applied wherever a draw leads."""
    try:
        for trial in possible_trials(cell):
            check_fault(trial)
    except NetworkError:
        return False
    return True


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


def disturbed_cells() -> list[Cell]:
    """List each dose of each disturbance with each of the paper's types: twice in Town01, twice in drawn towns."""
    doses = [Fault(kind=kind, dose=dose) for kind in DISTURBANCES for dose in doses_of(kind)]
    towns = itertools.cycle(f"drawn {number}" for number in range(8))
    return [
        Cell(town=town, junction_type=kind, fault=fault)
        for fault in doses
        for kind in PAPER_TYPES
        for town in ("Town01", "Town01", next(towns), next(towns))
    ]


RECIPES: Final[dict[str, tuple[str, Callable[[], Content]]]] = {
    "disturbed@1": ("Disturbances of camera, sensors and steering by dose; the commands are right", disturbed_cells),
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
    "wrong-command-extended@1": (
        "All faults: 13 kinds x 4 junction types in known and drawn towns, all weathers, alone and beside traffic",
        extended_cells,
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
