"""The tables of the stored results: ours beside the paper's, by junction type, condition and training seed."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from statistics import median
from typing import Final, NamedTuple

from rich.table import Table as RichTable
from rich.text import Text

from lab.stored_results import Collection
from wrongturn_agents.errors import ResultsError
from wrongturn_agents.results_file import ResultsFile
from wrongturn_agents.shipped_agents import DOUBTING_AGENTS
from wrongturn_agents.stored_results import table_order
from wrongturn_agents.suites import NAVIGATION, WRONG_COMMAND, installed_suite
from wrongturn_client.tables import plain_table
from wrongturn_protocol import (
    PAPER,
    PAPER_TYPES,
    Condition,
    FaultKind,
    JunctionType,
    PaperAgent,
    Task,
    Verdict,
    twin_id,
)
from wrongturn_protocol.intervals import Marks, interval, marks_of, wilson
from wrongturn_protocol.standing_rows import INTERVALS, TRAINED

Row = tuple[str, ...]
Cell = tuple[JunctionType, FaultKind]
PAPER_BY_NAME: Final = {agent.ours: agent for agent in PAPER}
"""The paper's agents by the name of ours, in the order of its tables."""
FAULTS: Final = (FaultKind.INFEASIBLE, FaultKind.OMISSION)
"""The paper's two faults, in the order of its rows."""
CONDITIONS: Final = {
    Condition.TRAINING: "training",
    Condition.NEW_WEATHER: "new weather",
    Condition.NEW_TOWN: "new town",
    Condition.NEW_TOWN_AND_WEATHER: "new town and weather",
}
_CELLS: Final = tuple((kind, fault) for kind in PAPER_TYPES for fault in FAULTS)
_TWINS_OF_A_DRIVER: Final = 0.9  # the share of its twins that an agent must complete, here and for a rank


class OutdatedPageError(ResultsError):
    """A page, picture, film or card does not show what is stored."""


class Table(NamedTuple):
    """A table of text cells. The columns behind the first ``words`` hold figures."""

    title: str
    head: Row
    rows: Sequence[Row]
    note: str = ""
    words: int = 2

    def rich(self) -> RichTable:
        """Return the table for the terminal."""
        table = plain_table(self.title)
        for number, name in enumerate(self.head):
            table.add_column(name, justify="left" if number < self.words else "right")
        for number, row in enumerate(self.rows, 1):
            # Only an agent's first row has its name: a line is drawn where the next row has one.
            last = number == len(self.rows) or bool(self.rows[number][0])
            table.add_row(*(Text(cell.replace("`", "")) for cell in row), end_section=last)
        table.caption = Text(self.note)
        return table

    def markdown(self) -> str:
        """Return the table for a page, with a line break at the end."""
        if not self.rows:
            return "*Nothing is stored yet.*\n"
        rule = "|".join("---" if number < self.words else "---:" for number in range(len(self.head)))
        lines = [f"| {' | '.join(row)} |" for row in (self.head, *self.rows)]
        lines.insert(1, f"|{rule}|")
        return "\n".join(lines) + "\n" + (f"\n*{self.note}*\n" if self.note else "")


def label(agent: str) -> str:
    """Return an agent's name for a table, marked if it met wrong commands in its training."""
    return f"`{agent}` {TRAINED}" if agent in DOUBTING_AGENTS else f"`{agent}`"


def label_first(name: str, rows: Iterable[Row]) -> list[Row]:
    """Put a name before the first row, and an empty cell before the others."""
    return [("" if number else name, *row) for number, row in enumerate(rows)]


def with_interval(count: int, trials: int, *, percent: bool = False) -> str:
    """Return a count of trials of one cell as text, or its rate in percent, with the rate's 95 % interval in percent.

    Of one cell it is Wilson's interval.
    """
    return _with_ends(count, trials, wilson(count, trials), percent=percent)


def marked(marks: Marks) -> str:
    """Return the number of marked trials as text, with the rate's 95 % interval in percent."""
    return _with_ends(*total(marks), interval(marks))


def total(marks: Marks) -> tuple[int, int]:
    """Return the numbers of marked trials and of all."""
    cells = [cell for places in marks.values() for cell in places.values()]
    return sum(count for count, _ in cells), sum(trials for _, trials in cells)


def _with_ends(count: int, trials: int, ends: tuple[float, float], *, percent: bool = False) -> str:
    low, high = ends
    shown = f"{100 * count / trials:.0f}" if percent else str(count)
    return f"{shown} ({100 * low:.0f}–{100 * high:.0f}{'' if percent else ' %'})"


def spread(values: Sequence[float]) -> str:
    """Return ``median [lowest–highest]`` of at least one value, such as one a training seed."""
    return f"{median(values):g} [{min(values):g}–{max(values):g}]"


@dataclass(frozen=True)
class UnsafeCounts:
    """Counts for one agent of one training seed."""

    strict: Mapping[Cell, int]
    """Unsafe trials by junction type and fault in the strict column."""
    marks: Mapping[str, Marks]
    """Unsafe trials (``strict`` and ``unsafe``, the paper's column) and ``completed`` twins."""

    @property
    def unsafe(self) -> int:
        """Number of unsafe trials in the paper's column."""
        return total(self.marks["unsafe"])[0]

    @property
    def trials(self) -> int:
        """Number of trials without the twins."""
        return total(self.marks["unsafe"])[1]

    @property
    def completed(self) -> int:
        """Number of completed twins."""
        return total(self.marks["completed"])[0]

    @property
    def twins(self) -> int:
        """Number of twins."""
        return total(self.marks["completed"])[1]

    @property
    def unsafe_strict(self) -> int:
        """Number of unsafe trials in the strict column."""
        return sum(self.strict.values())

    @property
    def drives(self) -> bool:
        """Whether the agent completes enough twins for its unsafe trials to mean anything."""
        return self.completed >= _TWINS_OF_A_DRIVER * self.twins


def count_unsafe(file: ResultsFile) -> UnsafeCounts:
    """Count a file's unsafe trials and completed twins."""
    drawn = file.drawn.trials
    faulted = {name: one for name, one in file.trials.items() if drawn[name].fault.kind is not FaultKind.NONE}
    strict = dict.fromkeys(_CELLS, 0)
    for name, one in faulted.items():
        strict[drawn[name].junction_type, drawn[name].fault.kind] += one.unsafe_strict
    pairs = [(drawn[name], one, file.trials.get(twin_id(drawn[name]))) for name, one in faulted.items()]
    marks = {
        "strict": marks_of((trial, one.unsafe_strict) for trial, one, _ in pairs),
        "unsafe": marks_of((trial, one.unsafe) for trial, one, _ in pairs),
        "completed": marks_of((trial, twin.completed) for trial, _, twin in pairs if twin),
    }
    return UnsafeCounts(strict, marks)


def counts_by_seed(collection: Collection, agent: str, variant: str | None = None) -> dict[int | None, UnsafeCounts]:
    """Return an agent's counts by training seed."""
    return {seed: count_unsafe(file) for seed, file in collection.by_seed(WRONG_COMMAND, agent, variant).items()}


def _beside_paper(
    collection: Collection,
    suite: str,
    paper_row: Callable[[PaperAgent], Iterable[str]],
    own_rows: Callable[[str], list[Row]],
) -> list[Row]:
    """Return the paper's agents, each with the rows of ours below it, and then the agents that the paper lacks."""
    rows: list[Row] = []
    for agent in PAPER:
        rows += label_first(f"`{agent.ours}`", [("the paper", *paper_row(agent)), *own_rows(agent.ours)])
    for name in collection.agents(suite):
        if name not in PAPER_BY_NAME:
            rows += label_first(label(name), own_rows(name))
    return rows


def wrong_command_table(collection: Collection) -> Table:
    """Return unsafe trials by junction type and fault in the strict column, with our figures beside the paper's."""
    head = ("agent", "source", *PAPER_TYPES, "unsafe of 60, strict", "the paper's column", "twins completed")
    note = (
        "Unsafe of 10: infeasible · omission, by type of junction, in the strict column. Our rows: "
        "the shipped weights over the service, on a draw of their own, with the 95 % interval of the rate; and "
        "the median [lowest–highest] over training seeds, on the open draw. Seeds that drive completed at least 54 of "
        "their 60 twins; the others say nothing about commands. † met wrong commands in its training. The paper has "
        f"only its own column, which its rows show. {INTERVALS}"
    )

    def paper(agent: PaperAgent) -> list[str]:
        cells = [f"{wrong} · {follow}" for wrong, follow in zip(agent.infeasible, agent.omission, strict=True)]
        return [*cells, "", marked(agent.marks), ""]

    def own(name: str) -> list[Row]:
        rows: list[Row] = []
        shipped = collection.of_shipped(WRONG_COMMAND, name)
        if shipped is not None:
            counts = count_unsafe(shipped)
            source = "ours" if shipped.seed is None else f"ours, seed {shipped.seed}"
            shown = (marked(counts.marks[column]) for column in ("strict", "unsafe"))
            rows.append((source, *_by_type(counts.strict), *shown, f"{counts.completed}/{counts.twins}"))
        seeds = [counts for seed, counts in counts_by_seed(collection, name).items() if seed is not None]
        if len(seeds) > 1:
            rows.append((f"ours, {len(seeds)} seeds", *_spreads(seeds)))
        driving = [counts for counts in seeds if counts.drives]
        if driving and len(driving) < len(seeds):
            which = "the one that drives" if len(driving) == 1 else f"the {len(driving)} that drive"
            rows.append((which, *_spreads(driving)))
        return rows

    return Table("Unsafe episodes, strict", head, _beside_paper(collection, WRONG_COMMAND, paper, own), note)


def _spreads(seeds: Sequence[UnsafeCounts]) -> list[str]:
    """Return cells, totals and completed twins over seeds."""
    cells = {cell: spread([one.strict[cell] for one in seeds]) for cell in _CELLS}
    totals = zip(*((one.unsafe_strict, one.unsafe, one.completed) for one in seeds), strict=True)
    return [*_by_type(cells), *map(spread, totals)]


def _by_type(cells: Mapping[Cell, object]) -> list[str]:
    return [" · ".join(str(cells[kind, fault]) for fault in FAULTS) for kind in PAPER_TYPES]


class Success(NamedTuple):
    """Counts of the journeys in one cell."""

    arrived: int
    clean: int
    """Journeys that arrived without any infraction."""
    episodes: int


@lru_cache(maxsize=1)
def _journeys(suite: str) -> dict[str, tuple[Task, Condition]]:
    found = installed_suite(suite).trials.items()
    return {name: (one.journey.task, Condition.of(one.town, one.weather)) for name, one in found if one.journey}


def count_success(file: ResultsFile) -> dict[tuple[Task, Condition], Success]:
    """Count a file's journeys by task and condition."""
    cells: dict[tuple[Task, Condition], Success] = {}
    for name, result in file.trials.items():
        cell, arrived = _journeys(file.suite)[name], result.verdict is Verdict.ARRIVED
        before = cells.get(cell, Success(0, 0, 0))
        clean = before.clean + (arrived and bool(result.clean))
        cells[cell] = Success(before.arrived + arrived, clean, before.episodes + 1)
    return cells


def navigation_table(collection: Collection) -> Table:
    """Return CoRL's task ``navigation``, with our figures beside the paper's."""
    note = (
        "Percent of routes completed in time; 25 routes in each cell. Our rows: the shipped weights with the 95 % "
        "interval, and the median [lowest–highest] over training seeds."
    )

    def own(name: str) -> list[Row]:
        rows = [*_shipped_row(collection, name, Task.NAVIGATION)]
        found = collection.by_seed(NAVIGATION, name).items()
        driven = (count_success(file) for seed, file in found if seed is not None)
        seeds = [cells for cells in driven if _has(cells, Task.NAVIGATION)]
        if len(seeds) > 1:
            each = ([_rate(cells.get((Task.NAVIGATION, where))) for cells in seeds] for where in CONDITIONS)
            shown = ([one for one in column if one is not None] for column in each)
            rows.append((f"ours, {len(seeds)} seeds", *(spread(one) if one else "–" for one in shown)))
        return rows

    rows = _beside_paper(collection, NAVIGATION, lambda agent: map(str, agent.success), own)
    head = ("agent", "source", *CONDITIONS.values())
    return Table("Navigation without traffic: success in % (the paper's table I)", head, rows, note)


def traffic_table(collection: Collection) -> Table:
    """Return CoRL's task beside traffic, of the shipped agents: routes that arrived, and those without infraction."""
    rows: list[Row] = []
    for name in collection.agents(NAVIGATION):
        for clean, what in ((False, "arrived"), (True, "without infraction")):
            found = _shipped_row(collection, name, Task.NAVIGATION_DYNAMIC, clean=clean)
            rows += [("" if clean else label(name), what, *row[1:]) for row in found]
    head = ("agent", "routes", *CONDITIONS.values())
    return Table("Navigation with traffic, shipped agents, in %", head, rows)


def _has(cells: Mapping[tuple[Task, Condition], Success], task: Task) -> bool:
    return any(of is task for of, _ in cells)


def _rate(one: Success | None) -> float | None:
    return None if one is None else 100 * one.arrived / one.episodes


def _shipped_row(collection: Collection, name: str, task: Task, *, clean: bool = False) -> list[Row]:
    """Return the row of a shipped agent's task; none if it was not driven."""
    shipped = collection.of_shipped(NAVIGATION, name)
    cells = {} if shipped is None else count_success(shipped)
    if shipped is None or not _has(cells, task):
        return []
    source = "ours" if shipped.seed is None else f"ours, seed {shipped.seed}"
    found = (cells.get((task, where)) for where in CONDITIONS)
    counts = ((one.clean if clean else one.arrived, one.episodes) if one else None for one in found)
    return [(source, *(with_interval(*one, percent=True) if one else "–" for one in counts))]


def _variants(collection: Collection) -> list[tuple[str, str]]:
    """Return the agents and variants of the ablations."""
    found = {(file.agent, file.variant) for file in collection.files if file.variant is not None}
    return sorted(found, key=lambda one: (*table_order(one[0]), one[1]))


def ablations_table(collection: Collection) -> Table:
    """Return what each part of a training is worth: variants without it, below the standard algorithm."""
    variants: dict[str, list[str | None]] = {}
    for agent, variant in _variants(collection):
        variants.setdefault(agent, [None]).append(variant)
    where = [condition for condition in Condition if condition is not Condition.TRAINING]
    rows: list[Row] = []
    for agent, named in variants.items():
        own: list[Row] = []
        for one_variant in named:
            found = collection.by_seed(NAVIGATION, agent, one_variant).items()
            journeys = {seed: count_success(file) for seed, file in found}
            counts = counts_by_seed(collection, agent, one_variant)
            cells = ([one.get((Task.NAVIGATION, condition)) for one in journeys.values()] for condition in where)
            own.append(
                (
                    (one_variant or "standard").replace("-", " "),
                    ", ".join(sorted(str(seed) for seed in journeys.keys() | counts.keys())),
                    *(_over([(one.arrived, one.episodes) for one in each if one], percent=True) for each in cells),
                    _over_counts(counts.values(), "strict"),
                    _over_counts(counts.values(), "completed"),
                )
            )
        rows += label_first(f"`{agent}`", own)
    head = ("agent", "variant", "seeds", *(CONDITIONS[one] for one in where), "unsafe of 60, strict", "twins")
    note = (
        "Navigation in % of 25 routes; unsafe trials (strict) and completed twins of 60, on the open draw. One seed: "
        "with the 95 % interval. Several seeds: the median [lowest–highest]."
    )
    return Table("Ablations", head, rows, note)


def _over(found: list[tuple[int, int]], *, percent: bool = False) -> str:
    """Return counts, each with its total, as text: one seed with its interval, several with their spread."""
    if len(found) < 2:
        return with_interval(*found[0], percent=percent) if found else "–"
    return spread([100 * count / of if percent else count for count, of in found])


def _over_counts(counts: Iterable[UnsafeCounts], what: str) -> str:
    found = [one.marks[what] for one in counts]
    if len(found) < 2:
        return marked(found[0]) if found else "–"
    return spread([total(marks)[0] for marks in found])
