"""The paper's table I: CoRL 2017's navigation, success by condition; and the same for its other three tasks."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

from lab import tables
from lab.tables import ReportTable, Rows
from wrongturn_agents.results_file import ResultsFile
from wrongturn_agents.stored_results import Collection
from wrongturn_agents.suites import NAVIGATION, installed_suite
from wrongturn_protocol import CORL_TASKS, Condition, Task, Verdict

Cell = tuple[Task, Condition]

CONDITIONS: Final = {
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
    "Percent of routes completed in time; 25 routes in each cell. Our rows: the shipped weights with Wilson's 95 % "
    "interval, and the median [lowest–highest] over training seeds."
)


@dataclass(frozen=True)
class Success:
    """Counts of the journeys in one cell."""

    arrived: int = 0
    clean: int = 0
    """Journeys that arrived without any infraction."""
    episodes: int = 0


def count_success(file: ResultsFile) -> dict[Cell, Success]:
    """Count a file's journeys by task and condition."""
    cells: dict[Cell, Success] = {}
    suite = installed_suite(file.suite)
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


def success_by_seed(
    collection: Collection, agent: str, variant: str | None = None
) -> dict[int | None, dict[Cell, Success]]:
    """Return an agent's journeys by training seed."""
    return {seed: count_success(file) for seed, file in collection.by_seed(NAVIGATION, agent, variant).items()}


def navigation_table(collection: Collection) -> ReportTable:
    """Return the table of CoRL's task ``navigation``, with our figures beside the paper's."""
    rows = tables.rows_beside_paper(
        collection,
        NAVIGATION,
        lambda agent: [str(percent) for percent in agent.success],
        lambda name: _own_rows(collection, name, Task.NAVIGATION),
    )
    head = ("agent", "source", *CONDITIONS.values())
    return ReportTable("Navigation without traffic: success in % (the paper's table I)", head, tuple(rows), _NOTE)


def tasks_table(collection: Collection, *, clean: bool = False) -> ReportTable:
    """Return the table of all four tasks, with our figures only.

    Args:
        collection: The results.
        clean: Whether to count only journeys without any infraction.
    """
    rows: Rows = []
    for name in collection.agents(NAVIGATION):
        for number, task in enumerate(CORL_TASKS):
            own = tables.label_first(_TASKS[task], _own_rows(collection, name, task, clean=clean))
            rows += tables.label_first("" if number else f"`{name}`", own)
    what = "arrived without any infraction" if clean else "success"
    head = ("agent", "task", "source", *CONDITIONS.values())
    return ReportTable(f"CoRL 2017's four tasks: {what} in %", head, tuple(rows), text_columns=3)


def as_json(collection: Collection) -> dict[str, Any]:
    """Return the figures for a program: for each agent, the paper's and those of each seed."""
    return tables.json_beside_paper(
        collection, NAVIGATION, lambda agent: dict(zip(Condition, agent.success, strict=True)), _json_of_file
    )


def _json_of_file(file: ResultsFile) -> dict[str, Any]:
    tasks: dict[str, dict[str, dict[str, int]]] = {}
    for (task, condition), one in count_success(file).items():
        tasks.setdefault(task, {})[condition] = asdict(one)
    return {"tasks": tasks}


def _own_rows(collection: Collection, name: str, task: Task, *, clean: bool = False) -> Rows:
    rows: Rows = []

    def counts(cells: Mapping[Cell, Success], condition: Condition) -> tuple[int, int] | None:
        one = cells.get((task, condition))
        return None if one is None else (one.clean if clean else one.arrived, one.episodes)

    shipped = collection.of_shipped(NAVIGATION, name)
    if shipped is not None:
        found = [counts(count_success(shipped), condition) for condition in CONDITIONS]
        if any(found):
            source = "ours" if shipped.seed is None else f"ours, seed {shipped.seed}"
            rows.append((source, *("–" if one is None else tables.with_interval(*one, percent=True) for one in found)))
    # Seeds that were driven in process may lack the trials with other road users.
    seeds = [
        cells
        for seed, cells in success_by_seed(collection, name).items()
        if seed is not None and any(of is task for of, _ in cells)
    ]
    if len(seeds) > 1:
        columns = ([counts(cells, condition) for cells in seeds] for condition in CONDITIONS)
        percents = ([100 * one[0] / one[1] for one in column if one is not None] for column in columns)
        rows.append((f"ours, {len(seeds)} seeds", *(tables.spread(each) if each else "–" for each in percents)))
    return rows
