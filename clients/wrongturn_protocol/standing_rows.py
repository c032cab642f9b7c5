"""A leaderboard's rows: their columns, words and figures, for pages, terminals, CSV, LaTeX and figures.

Whatever shows a standing asks here. ``Columns.of(results)`` returns the columns that some results need, and
``columns.row(metrics)`` the texts of one agent's row.
"""

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from wrongturn_protocol.intervals import LEVEL, interval
from wrongturn_protocol.leaderboards import Leaderboard, LeaderboardEntry
from wrongturn_protocol.paper import PAPER, PaperAgent
from wrongturn_protocol.results import Metrics, NavigationCount, TableCell
from wrongturn_protocol.vocabulary import PAPER_TYPES, Condition, Entry, FaultKind, JunctionType, Task
from wrongturn_protocol.words import name

TRAINED: Final = "†"
UPLOADED: Final = "‡"
MARKS: Final = {
    TRAINED: "met wrong commands in its training",
    UPLOADED: "was handed in as a file, and the service drove it",
}
"""What the marks after an agent's name mean."""
NONE: Final = "–"
"""Stands where there is no figure."""
INTERVALS: Final = (
    "An interval speaks of this agent on another draw of the same suite, and of other towns only if the suite draws "
    "its towns. Of a method you need several training seeds."
)
"""What an interval speaks of; it stands at every table that has one."""
LEVEL_HEADS: Final = ("Level", "Unsafe", "Rate", "95 %", "Twins")
"""Heads of :func:`breakdown_rows`."""


@dataclass(frozen=True)
class Column:
    """The head of a figure."""

    name: str
    meaning: str
    extra: bool = False
    """Whether tables with little room leave it out."""


@dataclass(frozen=True)
class Figure:
    """A figure, with its rate and its interval if it has them."""

    main: str
    rate: str = ""
    interval: str = ""


@dataclass(frozen=True)
class StandingRow:
    """The figures of one agent, algorithm, or agent of the paper."""

    figures: tuple[Figure, ...]
    """In the order of :attr:`Columns.figures`."""
    parts: tuple[tuple[str, ...], ...]
    """For each of :attr:`Columns.lines`, a text for each of :attr:`Columns.parts`."""
    rate: float | None = None
    """The rate that ranks; None for a row without one."""
    wide: tuple[float, float] = (0.0, 1.0)
    """Its 95 % interval; of an algorithm, the range over training seeds."""
    narrow: tuple[float, float] | None = None
    """Its 83.4 % interval, which decides the rank; None if nothing is ranked by it."""


@dataclass(frozen=True)
class Columns:
    """The heads of a table of standings."""

    journeys: bool
    title: str
    """What the table counts."""
    figures: tuple[Column, ...]
    line: str
    """Head of the names of the lines."""
    lines: tuple[str, ...]
    """Faults, or tasks of journeys."""
    parts: tuple[str, ...]
    """Junction types, or conditions of journeys."""

    @classmethod
    def of(cls, results: Iterable[Metrics], *, journeys: bool | None = None) -> "Columns":
        """Return the columns that results of one suite need.

        ``journeys`` tells whether it is a suite of journeys; None if the results say so.
        """
        results = list(results)
        if journeys is None:
            journeys = any(one.navigation is not None for one in results)
        found = [cell for one in results for cell in cells(one)]
        present = {part for cell in found for part in cell}
        if journeys:
            conditions = tuple(one for one in Condition if one in present or not found)
            tasks = tuple(one for one in Task if one in present) or (Task.NAVIGATION,)
            return cls(True, "journeys that reached their goal, in %", _JOURNEYS, "Task", tasks, conditions)
        types = (*PAPER_TYPES, *(one for one in JunctionType if one in present and one not in PAPER_TYPES))
        faults = [*FaultKind, *sorted(line for _, line in found if line not in set(FaultKind))]
        lines = tuple(dict.fromkeys(one for one in faults if one in present)) or tuple(PAPER[0].unsafe_of)
        return cls(False, "unsafe trials", _UNSAFE, "Fault", lines, types)

    def row(self, metrics: Metrics) -> StandingRow:
        """Return the texts of an agent's row."""
        found = cells(metrics)
        parts = self._parts({key: _text(cell) for key, cell in found.items()})
        return _journeys(metrics, parts) if self.journeys else _unsafe(metrics, parts)

    def clean(self, metrics: Metrics) -> tuple[tuple[str, ...], ...]:
        """Return the parts of journeys that also had no infraction, in percent."""
        found = metrics.navigation.table.items() if metrics.navigation else ()
        return self._parts(
            {
                (condition, task): _percent(one.clean, one.episodes)
                for task, row in found
                for condition, one in row.items()
            }
        )

    def row_of_paper(self, agent: PaperAgent) -> StandingRow:
        """Return the row of one of the paper's agents."""
        none = (Figure(NONE),) * len(self.figures)
        if self.journeys:
            success = zip(Condition, agent.success, strict=True)
            return StandingRow(none, self._parts({(one, Task.NAVIGATION): str(percent) for one, percent in success}))
        counts: dict[tuple[str, str], str] = {
            (kind, fault): f"{agent.unsafe_of[fault][number]}/10"
            for number, kind in enumerate(PAPER_TYPES)
            for fault in agent.unsafe_of
        }
        ends = interval(agent.marks)
        theirs = Figure(f"{agent.unsafe}/60", "", _interval(ends))
        return StandingRow((none[0], theirs, *none[2:]), self._parts(counts), agent.unsafe / 60, ends)

    def _parts(self, texts: dict[tuple[str, str], str]) -> tuple[tuple[str, ...], ...]:
        return tuple(tuple(texts.get((part, line), NONE) for part in self.parts) for line in self.lines)


_UNSAFE: Final = (
    Column("Strict", "Unsafe trials, with the rate's 95 % interval. This column ranks."),
    Column("Paper's", "Unsafe trials as the paper counts them: without wrong ways, unfinished drives and flags."),
    Column("Twins", "Completed twins: trials without a fault that ended in the commanded exit and are not unsafe."),
    Column("Excess", "Strict rate minus the twins' rate, in percentage points, with its 95 % interval.", extra=True),
)
_JOURNEYS: Final = (
    Column("Success", "Journeys that reached their goal in time, with the rate's 95 % interval."),
    Column("Clean", "Journeys that also had no infraction."),
    Column("Way covered", "Mean share of the shortest way.", extra=True),
)


def cells(metrics: Metrics) -> dict[tuple[str, str], TableCell | NavigationCount]:
    """Return the parts of the figure that ranks: by junction type and fault, or by condition and task of journeys."""
    if metrics.navigation is not None:
        return {(one, task): count for task, row in metrics.navigation.table.items() for one, count in row.items()}
    return {(kind, fault): cell for kind, row in (metrics.table_strict or {}).items() for fault, cell in row.items()}


def breakdown_rows(metrics: Metrics) -> list[tuple[str, list[tuple[str, ...]]]]:
    """Return the parts of a breakdown: the factor, and a row for each level; none for results without one.

    A row has the level, unsafe of all trials, their share, its 95 % interval, and completed twins.
    """
    return [
        (
            name(factor),
            [
                (
                    value if factor in {"town", "weather"} else ", ".join(map(name, value.split(" ", 1))),
                    f"{one.count}/{one.trials}",
                    f"{100 * one.rate:.0f} %",
                    _interval(one.ci95),
                    f"{one.completed}/{one.trials}",
                )
                for value, one in levels.items()
            ],
        )
        for factor, levels in (metrics.breakdown or {}).items()
    ]


def rank_of(entry: LeaderboardEntry) -> str:
    """Return an entry's rank. ``=`` says that other agents share it."""
    return NONE if entry.rank is None else f"{entry.rank}{'=' if entry.tied_with else ''}"


def name_of(entry: LeaderboardEntry) -> str:
    """Return an entry's name with its :data:`MARKS`."""
    marks = (TRAINED, entry.agent.trained_on_faults), (UPLOADED, entry.entry is Entry.UPLOADED)
    return " ".join([entry.agent.name, *(mark for mark, has in marks if has)])


def notes_of(entry: LeaderboardEntry) -> list[str]:
    """Return short facts about an entry. An owner of the agent's own name is left out."""
    notes = []
    if entry.seeds is not None:
        notes.append(f"{entry.seeds.count} training seeds")
    elif entry.agent.owner not in {"", entry.agent.name}:
        notes.append(f"by {entry.agent.owner}" + f", {entry.owner_agents} agents" * (entry.owner_agents > 1))
    if entry.severity is not None:
        notes.append(f"unsafe at {entry.severity.speed_mps:.1f} m/s")
    if entry.compliance is not None:
        notes.append(f"complied {entry.compliance.count}/{entry.compliance.trials}")
    tested = [(tie.p, tie.name) for tie in entry.ties if tie.p is not None]
    if tested:
        p, name = min(tested)
        notes.append(f"tied, p = {p:.2g} against {name}" if p <= LEVEL else f"tied, p ≥ {p:.2g}")
    return [*notes, *[f"{entry.aborted} aborted"] * bool(entry.aborted)]


def leaderboard_csv(board: Leaderboard) -> str:
    """Return a leaderboard as CSV (RFC 4180, with line feeds), in the order of its entries.

    Columns of junction types and faults, of tasks and conditions, and of compliance, are those that some entry has.
    A cell is empty where an entry has no such figure; truths are 0 and 1.
    """
    rows = [_csv_row(entry) for entry in board.entries]
    present = {column for row in rows for column in row}
    faults = [*FaultKind, *sorted(fault for entry in board.entries for _, fault in cells(entry))]
    parts: list[tuple[str, str]] = [*((kind, fault) for kind in JunctionType for fault in faults)]
    parts += [(condition, task) for task in Task for condition in Condition]
    columns = [one for one in (*_CSV, *dict.fromkeys(map(_csv_name, parts))) if one in present]
    out = io.StringIO()
    writer = csv.DictWriter(out, columns or _CSV, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


_CSV: Final = (
    *("rank", "agent", "owner", "track", "kind"),
    *("trained_on_faults", "entry", "eligible", "why_not"),
    *("tied_with", "tied_p", "trials"),
    *("unsafe_strict", "unsafe_strict_rate", "ci95_low", "ci95_high", "ci83_low", "ci83_high"),
    *("unsafe_paper", "unsafe_paper_rate", "paper_ci95_low", "paper_ci95_high"),
    *("twins", "twins_completed", "twins_unsafe"),
    *("excess", "excess_ci95_low", "excess_ci95_high", "excess_p"),
    *("severity_speed_mps", "severity_v2_mean"),
    *("complied", "complied_trials"),
    *("false_alarms_stopped", "false_alarms_overridden", "false_alarms_seconds_lost"),
    *("aborted", "seeds", "agent_id", "evaluation"),
)


def _csv_row(entry: LeaderboardEntry) -> dict[str, Any]:
    strict, paper, twins, excess = entry.unsafe_strict, entry.unsafe, entry.twins, entry.excess_unsafe_rate
    alarms, complied = entry.false_alarms, entry.compliance
    figures = (
        *(entry.rank, entry.agent.name, entry.agent.owner, entry.agent.track.value, entry.agent.kind.value),
        *(int(entry.agent.trained_on_faults), entry.entry and entry.entry.value, int(entry.eligible), entry.why_not),
        *(";".join(entry.tied_with), ";".join("" if tie.p is None else f"{tie.p:.4g}" for tie in entry.ties)),
        *(strict.trials, strict.count, strict.rate, *strict.ci95),
        *(strict.ci83 or (None, None)),
        *(paper.count, paper.rate, *paper.ci95, twins.trials, twins.completed, twins.unsafe),
        *((excess.value, *excess.ci95, excess.p) if excess else (None,) * 4),
        *((entry.severity.speed_mps, entry.severity.v2_mean) if entry.severity else (None,) * 2),
        *((complied.count, complied.trials) if complied else ()),
        *((alarms.stopped, alarms.overridden, alarms.seconds_lost) if alarms else (None,) * 3),
        *(entry.aborted, entry.seeds and entry.seeds.count, entry.agent.id, entry.evaluation),
    )
    return {
        **dict(zip([one for one in _CSV if complied or not one.startswith("complied")], figures, strict=True)),
        **{_csv_name(key): _count(cell) for key, cell in cells(entry).items()},
    }


def _csv_name(part: tuple[str, str]) -> str:
    return f"arrived_{part[1]}_{part[0]}" if part[0] in set(Condition) else f"unsafe_strict_{part[0]}_{part[1]}"


def _unsafe(metrics: Metrics, parts: tuple[tuple[str, ...], ...]) -> StandingRow:
    strict, excess = metrics.unsafe_strict, metrics.excess_unsafe_rate
    wide, narrow, shown = strict.ci95, strict.ci83, _interval(strict.ci95)
    if isinstance(metrics, LeaderboardEntry) and metrics.seeds is not None:
        spread = metrics.seeds.unsafe_strict
        wide, narrow = (spread.lowest / strict.trials, spread.highest / strict.trials), None
        shown = f"seeds {spread.lowest}–{spread.highest}"
    figures = (
        Figure(f"{strict.count}/{strict.trials}", f"{100 * strict.rate:.0f} %", shown),
        Figure(f"{metrics.unsafe.count}/{metrics.unsafe.trials}"),
        Figure(f"{metrics.twins.completed}/{metrics.twins.trials}"),
        Figure(_signed(excess.value), "", f"[{', '.join(map(_signed, excess.ci95))}]") if excess else Figure(NONE),
    )
    return StandingRow(figures, parts, strict.rate, wide, narrow)


def _journeys(metrics: Metrics, parts: tuple[tuple[str, ...], ...]) -> StandingRow:
    assert metrics.navigation is not None
    total = metrics.navigation.total
    figures = (
        Figure(f"{total.success}/{total.episodes}", f"{100 * total.rate:.0f} %", _interval(total.ci95)),
        Figure(f"{_percent(total.clean, total.episodes)} %"),
        Figure(f"{100 * total.completion:.0f} %"),
    )
    return StandingRow(figures, parts, total.rate, total.ci95)


def _text(cell: TableCell | NavigationCount) -> str:
    if isinstance(cell, TableCell):
        return f"{cell.unsafe}/{cell.trials}" if cell.trials else NONE
    return _percent(cell.success, cell.episodes)


def _count(cell: TableCell | NavigationCount) -> int:
    return cell.unsafe if isinstance(cell, TableCell) else cell.success


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.0f}"


def _interval(ends: Sequence[float]) -> str:
    return f"[{100 * ends[0]:.0f}, {100 * ends[1]:.0f}] %"


def _signed(rate: float) -> str:
    """Return a rounded percentage with its sign: ``+5`` or ``0``."""
    rounded = round(100 * rate)
    return "0" if rounded == 0 else f"{rounded:+d}".replace("-", "\N{MINUS SIGN}")
