"""The rows of a leaderboard's page. They say the same as ``wrongturn leaderboard``."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from wrongturn_protocol import (
    PAPER,
    PAPER_TYPES,
    AgentKind,
    Condition,
    Entry,
    FaultKind,
    JunctionType,
    Leaderboard,
    LeaderboardEntry,
    NavigationCount,
    NavigationMetrics,
    PaperAgent,
    Task,
    Track,
)
from wrongturn_service.evaluation.ranking import interval
from wrongturn_service.evaluation.statistics import wilson
from wrongturn_service.web import words
from wrongturn_service.web.bars import Bar, bar

ROWS: Final = 100
"""Agents on one page."""
TRACKS: Final = {
    Track.CAMERA: "Camera",
    Track.SEGMENTATION: "Segmentation",
    Track.PRIVILEGED: "Privileged",
    Track.STATE: "State",
}
KINDS: Final = {
    AgentKind.SUBMITTED: "submitted",
    AgentKind.REFERENCE: "reference",
    AgentKind.BASELINE: "baseline",
    AgentKind.EXPLOIT: "exploit",
    AgentKind.ALGORITHM: "algorithm",
}
_OF_PAPER: Final = (FaultKind.INFEASIBLE, FaultKind.OMISSION)
"""The paper's faults."""
_MOST_PARTS: Final = 4
"""Faults that a row has room for. A suite with more has its parts on the agents' pages alone."""


@dataclass(frozen=True)
class Figure:
    """A figure of two lines."""

    main: str
    below: str = ""


@dataclass(frozen=True)
class Row:
    """One agent, algorithm, or agent of the paper."""

    rank: str
    name: str
    agent: str | None
    """Id of the agent; None if it has no page."""
    notes: tuple[str, ...]
    """Short facts below the name."""
    why_not: str | None
    """Why an agent has no rank."""
    bar: Bar | None
    figures: tuple[Figure, ...]
    """In the order of :attr:`Columns.figures`."""
    lines: tuple[str, ...]
    """Names of the lines of the parts: faults, or tasks."""
    parts: tuple[tuple[str, ...], ...]
    """For each column of the parts, a figure for each line."""


@dataclass(frozen=True)
class Group:
    """Rows of one track."""

    title: str
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class Columns:
    """The heads of the table."""

    scale: str
    """What the axis of the bars shows."""
    figures: tuple[tuple[str, str], ...]
    """Name of each figure, and what it is."""
    lines: str
    """Head of the names of the lines."""
    parts: tuple[str, ...]
    meanings: tuple[tuple[str, str], ...]
    """Name of each line that needs an explanation, and what it means."""


@dataclass(frozen=True)
class First:
    """The agents of rank 1 in one track."""

    track: str
    names: tuple[str, ...]
    ranked: int
    """Number of agents with a rank in this track."""


@dataclass(frozen=True)
class Standings:
    """A leaderboard's table, or a page of it."""

    columns: Columns
    groups: tuple[Group, ...]
    paper: Group | None
    """The paper's agents, for comparison."""
    first: tuple[First, ...]
    """The agents of rank 1, by track."""
    shown: int
    """Number of entries that pass the filter."""
    page: int
    pages: int


def standings(
    board: Leaderboard, entries: Sequence[LeaderboardEntry], page: int, journeys: bool, paper: bool
) -> Standings:
    """Return one page of a leaderboard.

    Args:
        board: The leaderboard.
        entries: Those of its entries that pass the filter.
        page: Number of the page, from 1.
        journeys: Whether the suite is one of journeys.
        paper: Whether the paper's agents are shown, if the suite has figures of the paper.
    """
    # Rows over training seeds are never ranked: they stand in a group of their own, after all agents.
    here = sorted(entries, key=lambda entry: entry.seeds is not None)[(page - 1) * ROWS : page * ROWS]
    name = board.suite.partition("@")[0] if paper else ""
    if journeys:
        table = _JourneyTable([entry.navigation for entry in board.entries if entry.navigation is not None])
        of_paper = [_paper_journeys(agent, table) for agent in PAPER] if name == "navigation" else []
        rows = [table.row(entry) for entry in here]
        columns = table.columns
    else:
        unsafe = _UnsafeTable(board.entries)
        of_paper = [_paper_unsafe(agent, unsafe) for agent in PAPER] if name == "wrong-command" else []
        rows = [unsafe.row(entry) for entry in here]
        columns = unsafe.columns
    return Standings(
        columns=columns,
        groups=tuple(_grouped(here, rows)),
        paper=Group("The paper's agents, in CARLA", tuple(of_paper)) if of_paper else None,
        first=tuple(_first(board)),
        shown=len(entries),
        page=page,
        pages=page_count(entries),
    )


def page_count(entries: Sequence[LeaderboardEntry]) -> int:
    """Return how many pages a table has; an empty one has one."""
    return max(1, -(-len(entries) // ROWS))


def _first(board: Leaderboard) -> Iterable[First]:
    for track, title in TRACKS.items():
        ranked = [entry for entry in board.entries if entry.rank is not None and entry.agent.track is track]
        if ranked:
            names = tuple(entry.agent.name for entry in ranked if entry.rank == 1)
            yield First(f"{title} track", names, len(ranked))


def _grouped(entries: Sequence[LeaderboardEntry], rows: Sequence[Row]) -> Iterable[Group]:
    both = list(zip(entries, rows, strict=True))
    for track, title in TRACKS.items():
        found = tuple(row for entry, row in both if entry.agent.track is track and entry.seeds is None)
        if found:
            yield Group(f"{title} track", found)
    algorithms = tuple(row for entry, row in both if entry.seeds is not None)
    if algorithms:
        yield Group("Our algorithms, median over training seeds; not ranked", algorithms)


class _UnsafeTable:
    """Unsafe episodes: the strict column, which ranks, the paper's, the twins, and the parts of the strict column."""

    def __init__(self, entries: Iterable[LeaderboardEntry]) -> None:
        cells = [entry.table_strict or entry.table for entry in entries]
        types = {kind for table in cells for kind in table}
        faults = {fault for table in cells for row in table.values() for fault in row}
        self.types = (*PAPER_TYPES, *(kind for kind in JunctionType if kind not in PAPER_TYPES and kind in types))
        self.faults = [fault for fault in FaultKind if fault in faults or fault in _OF_PAPER]
        if len(self.faults) > _MOST_PARTS:
            self.types, self.faults = (), []
        self.columns = Columns(
            scale="Unsafe, strict",
            figures=(
                ("Strict", "Unsafe episodes, with the rate's 95 % interval. This column ranks."),
                ("Paper's", "Unsafe episodes as the paper counts them: wrong ways are left out."),
                ("Twins", "Completed twins: trials without a fault that ended in the commanded exit."),
                ("Excess", "Strict rate minus the twins' rate, in percentage points, with its 95 % interval."),
            ),
            lines="Fault",
            parts=tuple(words.name(kind) for kind in self.types),
            meanings=tuple((words.name(fault), words.FAULTS[fault]) for fault in self.faults),
        )
        self.lines = tuple(words.name(fault) for fault in self.faults)

    def row(self, entry: LeaderboardEntry) -> Row:
        strict, excess, seeds = entry.unsafe_strict, entry.excess_unsafe_rate, entry.seeds
        cells = entry.table_strict or entry.table
        parts = tuple(
            tuple(
                f"{cell.unsafe}/{cell.trials}" if (cell := cells.get(kind, {}).get(fault)) else "–"
                for fault in self.faults
            )
            for kind in self.types
        )
        if seeds is None:
            low, high = strict.ci95
            counted, drawn = f"[{100 * low:.0f}, {100 * high:.0f}] %", bar(strict.rate, strict.ci95, strict.ci83)
        else:
            least, most = seeds.unsafe_strict.lowest, seeds.unsafe_strict.highest
            counted = f"seeds {least}–{most}"
            drawn = bar(strict.rate, (least / strict.trials, most / strict.trials))
        figures = (
            Figure(f"{strict.count}/{strict.trials} · {100 * strict.rate:.0f} %", counted),
            Figure(f"{entry.unsafe.count}/{entry.unsafe.trials}"),
            Figure(f"{entry.twins.completed}/{entry.twins.trials}"),
            Figure("–")
            if excess is None
            else Figure(
                _signed(100 * excess.value), f"[{_signed(100 * excess.ci95[0])}, {_signed(100 * excess.ci95[1])}]"
            ),
        )
        return _row(entry, drawn, figures, self.lines, parts)


class _JourneyTable:
    """Journeys that reached their goal, by task and condition."""

    def __init__(self, found: Sequence[NavigationMetrics]) -> None:
        tasks = {task for metrics in found for task in metrics.table}
        conditions = {condition for metrics in found for row in metrics.table.values() for condition in row}
        self.tasks = [task for task in Task if task in tasks]
        self.conditions = [condition for condition in Condition if condition in conditions or not found]
        self.columns = Columns(
            scale="Reached the goal",
            figures=(
                ("Success", "Journeys that reached their goal in time, with the rate's 95 % interval."),
                ("Clean", "Journeys that also had no infraction."),
                ("Way covered", "Mean share of the shortest way."),
            ),
            lines="Task",
            parts=tuple(words.condition(condition) for condition in self.conditions),
            meanings=(),
        )
        self.lines = tuple(words.task(task) for task in self.tasks)

    def row(self, entry: LeaderboardEntry) -> Row:
        metrics = entry.navigation
        assert metrics is not None
        total = metrics.total
        low, high = total.ci95
        worst, best = interval(entry)
        figures = (
            Figure(
                f"{total.success}/{total.episodes} · {100 * total.rate:.0f} %",
                f"[{100 * low:.0f}, {100 * high:.0f}] %",
            ),
            Figure(f"{100 * total.clean / total.episodes:.0f} %"),
            Figure(f"{100 * total.completion:.0f} %"),
        )
        parts = tuple(
            tuple(_success(metrics.table.get(task, {}).get(condition)) for task in self.tasks)
            for condition in self.conditions
        )
        return _row(entry, bar(total.rate, total.ci95, (1 - best, 1 - worst), "success"), figures, self.lines, parts)


def _row(
    entry: LeaderboardEntry,
    drawn: Bar,
    figures: tuple[Figure, ...],
    lines: tuple[str, ...],
    parts: tuple[tuple[str, ...], ...],
) -> Row:
    agent = entry.agent
    if entry.seeds is not None:
        notes = [f"{TRACKS[agent.track].lower()} track", f"{entry.seeds.count} training seeds"]
    else:
        notes = [KINDS[agent.kind]]
        if agent.owner not in {"", agent.name}:
            notes.append(f"by {agent.owner}" + (f", {entry.owner_agents} agents" if entry.owner_agents > 1 else ""))
    if entry.aborted:
        notes.append(f"{entry.aborted} aborted")
    return Row(
        rank="–" if entry.rank is None else f"{entry.rank}{'=' if entry.tied_with else ''}",
        name=agent.name + " †" * agent.trained_on_faults + " ‡" * (entry.entry is Entry.UPLOADED),
        agent=agent.id if entry.seeds is None else None,
        notes=tuple(notes),
        why_not=entry.why_not if entry.seeds is None else None,
        bar=drawn,
        figures=figures,
        lines=lines,
        parts=parts,
    )


def _paper_unsafe(agent: PaperAgent, table: _UnsafeTable) -> Row:
    low, high = ends = wilson(agent.unsafe, 60)
    cells = {FaultKind.INFEASIBLE: agent.infeasible, FaultKind.OMISSION: agent.omission}
    paper = {
        (kind, fault): f"{count}/10"
        for fault, row in cells.items()
        for kind, count in zip(PAPER_TYPES, row, strict=True)
    }
    figures = (
        Figure("–"),
        Figure(f"{agent.unsafe}/60", f"[{100 * low:.0f}, {100 * high:.0f}] %"),
        Figure("–"),
        Figure("–"),
    )
    parts = tuple(tuple(paper.get((kind, fault), "–") for fault in table.faults) for kind in table.types)
    return _paper_row(agent, bar(agent.unsafe / 60, ends, style="reference"), figures, table.lines, parts)


def _paper_journeys(agent: PaperAgent, table: _JourneyTable) -> Row:
    found = dict(zip(Condition, agent.success, strict=True))
    parts = tuple((str(found[condition]),) for condition in table.conditions)
    return _paper_row(agent, None, (Figure("–"),) * len(table.columns.figures), (words.task(Task.NAVIGATION),), parts)


def _paper_row(
    agent: PaperAgent,
    drawn: Bar | None,
    figures: tuple[Figure, ...],
    lines: tuple[str, ...],
    parts: tuple[tuple[str, ...], ...],
) -> Row:
    return Row("–", agent.title, None, (f"the design of {agent.ours}",), None, drawn, figures, lines, parts)


def _success(count: NavigationCount | None) -> str:
    return "–" if count is None else f"{100 * count.success / count.episodes:.0f}"


def _signed(value: float) -> str:
    """Return a rounded number with its sign: ``+5``, ``-3``, ``0``."""
    rounded = round(value)
    return "0" if rounded == 0 else f"{rounded:+d}".replace("-", "\N{MINUS SIGN}")
