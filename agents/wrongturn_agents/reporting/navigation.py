"""The paper's table I: CoRL 2017's navigation, success by condition; and its three sisters."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from wrongturn_agents.reporting.collection import Collection
from wrongturn_agents.reporting.paper import LIKE, PAPER
from wrongturn_agents.reporting.report_table import ReportTable
from wrongturn_agents.reporting.results_file import ResultsFile
from wrongturn_agents.reporting.spread import Spread, with_interval
from wrongturn_agents.suites import NAVIGATION, SuiteTrials
from wrongturn_protocol import CORL_TASKS, Condition, Task, Verdict

Cell = tuple[Task, Condition]

_CONDITIONS: Final = {
    Condition.TRAINING: "training",
    Condition.NEW_WEATHER: "new weather",
    Condition.NEW_TOWN: "new town",
    Condition.NEW_TOWN_AND_WEATHER: "new town and weather",
}
_TASKS: Final = {
    Task.STRAIGHT: "straight",
    Task.ONE_TURN: "one turn",
    Task.NAVIGATION: "navigation",
    Task.NAVIGATION_DYNAMIC: "navigation with traffic",
}
_NOTE: Final = (
    "Routes completed in time, percent; 25 routes a cell. Ours: the shipped weights with Wilson's 95 % interval, and "
    "median [least–most] over training seeds."
)


@dataclass(frozen=True)
class Success:
    """Journeys of one cell."""

    arrived: int = 0
    clean: int = 0
    """Of these, without any infraction."""
    episodes: int = 0

    @property
    def percent(self) -> float:
        """Those that arrived."""
        return 100 * self.arrived / self.episodes

    @property
    def percent_clean(self) -> float:
        """Those that arrived without any infraction."""
        return 100 * self.clean / self.episodes


def count_success(file: ResultsFile, suite: SuiteTrials) -> dict[Cell, Success]:
    """Count a file's journeys by task and condition."""
    cells: dict[Cell, Success] = {}
    for name, result in file.trials.items():
        trial = suite.trials[name]
        if trial.journey is None:
            continue
        cell = (trial.journey.task, Condition.of(trial.town, trial.weather))
        before = cells.get(cell, Success())
        arrived = result.verdict is Verdict.ARRIVED
        clean = arrived and bool(result.clean)
        cells[cell] = Success(before.arrived + arrived, before.clean + clean, before.episodes + 1)
    return cells


def by_seed(collection: Collection, agent: str, variant: str | None = None) -> dict[int | None, dict[Cell, Success]]:
    """An agent's journeys by training seed."""
    files = collection.of(NAVIGATION, agent, variant)
    return {seed: count_success(file, collection.suite_of(NAVIGATION)) for seed, file in files.items()}


def navigation_table(collection: Collection) -> ReportTable:
    """CoRL's task ``navigation``, ours beside the paper's; the paper's rows alone where nothing is stored."""
    rows: list[tuple[str, ...]] = []
    for agent in PAPER:
        paper = ("the paper", *(str(percent) for percent in agent.success))
        if agent.ours is None:
            rows.append((agent.title, *paper))
        else:
            own = _own_rows(collection, agent.ours, Task.NAVIGATION)
            rows += _named(f"`{agent.ours}`", [paper, *own])
    for name in collection.agents(NAVIGATION):
        if name not in LIKE:
            rows += _named(f"`{name}`", _own_rows(collection, name, Task.NAVIGATION))
    head = ("agent", "figures of", *_CONDITIONS.values())
    return ReportTable("Navigation without traffic: success in % (the paper's table I)", head, tuple(rows), (_NOTE,))


def tasks_table(collection: Collection, *, clean: bool = False) -> ReportTable:
    """All four tasks, ours alone.

    Args:
        collection: the results.
        clean: count journeys without any infraction only.
    """
    rows: list[tuple[str, ...]] = []
    for name in collection.agents(NAVIGATION):
        for number, task in enumerate(CORL_TASKS):
            own = _own_rows(collection, name, task, clean=clean)
            whose = "" if number else f"`{name}`"
            rows += [("" if at else whose, "" if at else _TASKS[task], *row) for at, row in enumerate(own)]
    what = "arrived without any infraction" if clean else "success"
    head = ("agent", "task", "figures of", *_CONDITIONS.values())
    return ReportTable(f"CoRL 2017's four tasks: {what} in %", head, tuple(rows), words=3)


def as_json(collection: Collection) -> dict[str, Any]:
    """The same figures for a program: by agent, the paper's and each seed's."""
    names = [*LIKE, *(name for name in collection.agents(NAVIGATION) if name not in LIKE)]
    return {
        name: {
            "paper": {condition: LIKE[name].succeeded(condition) for condition in Condition} if name in LIKE else None,
            "shipped_seed": collection.shipped.get(name),
            "seeds": [{"seed": seed, "tasks": _keyed(cells)} for seed, cells in by_seed(collection, name).items()],
        }
        for name in names
    }


def _keyed(cells: Mapping[Cell, Success]) -> dict[str, dict[str, dict[str, int]]]:
    tasks: dict[str, dict[str, dict[str, int]]] = {}
    for (task, condition), one in cells.items():
        figures = {"arrived": one.arrived, "clean": one.clean, "episodes": one.episodes}
        tasks.setdefault(task, {})[condition] = figures
    return tasks


def _named(name: str, rows: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """The rows of one agent, its name before the first."""
    return [("" if number else name, *row) for number, row in enumerate(rows)]


def _own_rows(collection: Collection, name: str, task: Task, *, clean: bool = False) -> list[tuple[str, ...]]:
    rows = []
    shipped = collection.of_shipped(NAVIGATION, name)
    if shipped is not None:
        cells = count_success(shipped, collection.suite_of(NAVIGATION))
        found = [cells.get((task, condition)) for condition in _CONDITIONS]
        texts = (_interval(one, clean=clean) for one in found)
        if any(found):
            rows.append(("ours" if shipped.seed is None else f"ours, seed {shipped.seed}", *texts))
    found_by_seed = by_seed(collection, name).items()
    # Seeds that were driven in process may lack the trials with other road users.
    seeds = [cells for seed, cells in found_by_seed if seed is not None and any(task is of for of, _ in cells)]
    if len(seeds) > 1:
        texts = (_spread([cells.get((task, condition)) for cells in seeds], clean=clean) for condition in _CONDITIONS)
        rows.append((f"ours, {len(seeds)} seeds", *texts))
    return rows


def _interval(one: Success | None, *, clean: bool) -> str:
    if one is None:
        return "–"
    return with_interval(one.clean if clean else one.arrived, one.episodes, percent=True)


def _spread(found: list[Success | None], *, clean: bool) -> str:
    present = [one for one in found if one is not None]
    if not present:
        return "–"
    return str(Spread.of([one.percent_clean if clean else one.percent for one in present]))
