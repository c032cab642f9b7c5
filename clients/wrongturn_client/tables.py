"""Results in the layout of the reference paper: a column for each junction type, a row for each fault."""

import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final

from rich.console import Console, ConsoleOptions
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from wrongturn_client.navigation_tables import navigation_leaderboard, navigation_table
from wrongturn_client.plain_table import add_ranked, notes, plain_table, ranking_table
from wrongturn_protocol import (
    PAPER_TYPES,
    Comparison,
    FaultKind,
    JunctionType,
    Leaderboard,
    LeaderboardEntry,
    Metrics,
    TableCell,
)

WIDTH: Final = 132
"""Columns for a leaderboard; used when the output is not a terminal."""
_ROOMY: Final = 106
"""From this many columns on, no heading of a leaderboard is broken."""
_BROAD: Final = 60
"""Columns of an empty table, so that the lines below it have room."""
OLD: Final = "Junction types show the paper's column."
"""Said below results that are too old to have strict cells."""
_NO_ENTRY: Final = "Another evaluation of this agent is its entry on the leaderboard."
_ROWS: Final = {FaultKind.INFEASIBLE: "wrong command", FaultKind.OMISSION: "follow lane"}
"""The paper's words for its two faults."""


def console(*, stderr: bool = False) -> Console:
    """Return a console that does not squeeze tables when the output goes to a file or a pipe."""
    plain = Console(stderr=stderr, highlight=False)
    return plain if plain.is_terminal else Console(stderr=stderr, highlight=False, width=WIDTH)


class Breakable:
    """Words of a fixed column: on one line, or broken only after ``at`` on a narrow terminal.

    rich narrows the widest columns, so that they lose letters. A column of these takes its longest word at most there,
    and leaves the rest to the agents' names.
    """

    def __init__(self, words: str, at: str) -> None:
        self._words = words
        self._broken = words.replace(at, f"{at}\n")
        self.min_width = max(len(line.rstrip()) for line in self._broken.split("\n"))

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        return Measurement(self.min_width, len(self._words) if options.max_width >= _ROOMY else self.min_width)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Text]:
        yield Text(self._words if options.max_width >= len(self._words) else self._broken)


def type_head(kind: JunctionType) -> Breakable:
    """Return a junction type as the heading of a column."""
    return Breakable(kind.value, "_")


def leaderboard_table(leaderboard: Leaderboard, others: Sequence[str] = (), url: str | None = None) -> Table:
    """Return the ranking on a suite, with a row for wrong commands and a row for "follow lane" for each agent.

    ``strict`` is the count that ranks, with its rate and below it Wilson's 95% interval. The columns of junction types
    are its parts; for results that are too old to have these, they are parts of ``paper``, the count in the paper's
    column. ``twins done`` counts the completed trials without fault. An algorithm has its median seed's figures, and
    below ``strict`` the lowest and highest count of its seeds.
    A suite of journeys has CoRL 2017's layout instead: a row for each task, a column for each condition.

    Args:
        leaderboard: The ranking.
        others: Suites with entries, named if this one has none.
        url: URL that the commands for those name. None: they name none.
    """
    lines = notes(leaderboard)
    if not leaderboard.entries:
        return _empty_leaderboard(leaderboard.suite, lines, others, url)
    if any(entry.navigation for entry in leaderboard.entries):
        table = navigation_leaderboard(leaderboard)
    else:
        table = _unsafe_leaderboard(leaderboard)
    old = [entry.agent.name for entry in leaderboard.entries if entry.table and not entry.table_strict]
    if old:
        whose = "" if len(old) == len(leaderboard.entries) else f" for {', '.join(old)}"
        lines.insert(0, f"{OLD[:-1]}{whose}.")
    if lines:
        table.caption = Text("\n".join(lines))
    return table


def _empty_leaderboard(suite: str, lines: Sequence[str], others: Sequence[str], url: str | None) -> Table:
    where = "" if url is None else f" --url {shlex.quote(url)}"
    commands = [f"wrongturn leaderboard {other}{where}" for other in others]
    # Only an entry tells which of the two layouts the suite has.
    table = plain_table(suite)
    table.add_column("rank")
    # One line each, so that no command is broken.
    table.add_column("agent", min_width=max([_BROAD, *map(len, commands)]))
    said = [*lines, "No evaluation on this suite has been finished yet."]
    table.caption = Text("\n".join([*said, *["There are some on others:"] * bool(commands), *commands]))
    return table


def _unsafe_leaderboard(leaderboard: Leaderboard) -> Table:
    types = _types(leaderboard.entries)
    table = ranking_table(f"{leaderboard.suite}: unsafe episodes", leaderboard.entries)
    _result_columns(table, types)
    for entry in leaderboard.entries:
        add_ranked(table, entry, _result_rows(entry, types))
    return table


def evaluation_table(name: str, metrics: Metrics) -> Table:
    """Return the results of one agent's finished evaluation, in the layout of the leaderboard."""
    if metrics.navigation is not None:
        return navigation_table(name, metrics.navigation)
    types = _types([metrics])
    table = plain_table(f"{name}: unsafe episodes")
    _result_columns(table, types)
    for row in _result_rows(metrics, types):
        table.add_row(*row)
    column, lines = ("strict", []) if metrics.table_strict else ("paper's", [OLD])
    if (excess := metrics.excess_unsafe_rate) is not None:
        low, high = excess.ci95
        lines.append(
            f"{column} rate minus the twins' rate: {100 * excess.value:+.0f} points, "
            f"95% CI [{100 * low:+.0f}, {100 * high:+.0f}], p = {excess.p:.2g}"
        )
    if lines:
        table.caption = Text("\n".join(lines))
    return table


def comparison_table(comparison: Comparison) -> Table:
    """Return two agents' unsafe trials by stratum, and what they say."""
    table = plain_table(f"{comparison.suite}: {comparison.a.name} and {comparison.b.name}")
    table.add_column("stratum", min_width=_BROAD // 2)
    for agent in (comparison.a, comparison.b):
        table.add_column(Text(agent.name), justify="right", overflow="fold")
    for one in comparison.strata:
        parts = (one.junction_type or one.task, one.fault or one.condition)
        name = ", ".join(part.value for part in parts if part is not None)
        table.add_row(*map(Text, (name, *(f"{cell.unsafe}/{cell.trials}" for cell in (one.a, one.b)))))
    totals = (f"{cell.unsafe}/{cell.trials}" for cell in (comparison.total_a, comparison.total_b))
    table.add_section()
    table.add_row(*map(Text, ("all", *totals)))
    table.caption = Text(comparison.sentence)
    return table


def standing(leaderboard: Leaderboard, evaluation: str) -> str:
    """Return a sentence about an evaluation's place: its rank and the interval that decides it, or why it has none."""
    entry = _entry(leaderboard, evaluation)
    if entry is None:
        return _NO_ENTRY
    if entry.rank is None:
        return f"Not ranked: {entry.why_not or 'not eligible'}"
    track = entry.agent.track
    ranked = sum(other.rank is not None and other.agent.track is track for other in leaderboard.entries)
    tied = f", tied with {_enumerated(entry.tied_with)}" if entry.tied_with else ""
    return f"Rank {entry.rank} of {ranked} in the {track} track{tied}{_strict(entry)}"


def prospect(leaderboard: Leaderboard, evaluation: str) -> str:
    """Return whether an agent with an evaluation's results would have a rank on a service that stays, and why not."""
    entry = _entry(leaderboard, evaluation)
    if entry is None:
        return _NO_ENTRY
    if entry.rank is None:
        return f"Would not be ranked on {leaderboard.suite}: {entry.why_not or 'not eligible'}"
    return f"Would be ranked on {leaderboard.suite} in the {entry.agent.track} track{_strict(entry)}"


def _entry(leaderboard: Leaderboard, evaluation: str) -> LeaderboardEntry | None:
    return next((entry for entry in leaderboard.entries if entry.evaluation == evaluation), None)


def _strict(entry: LeaderboardEntry) -> str:
    """Return the end of a sentence about a rank: the strict count and its interval."""
    if entry.navigation is not None:  # journeys; the caption of their table has the interval
        return "."
    strict = entry.unsafe_strict
    low, high = strict.ci95
    return f"; unsafe {strict.count} of {strict.trials} (strict), 95 % interval {100 * low:.0f} to {100 * high:.0f} %."


def _enumerated(names: Sequence[str]) -> str:
    """Return names as a text reads them: ``a``, ``a and b``, ``a, b and c``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _cells(metrics: Metrics) -> Mapping[JunctionType, Mapping[str, TableCell]]:
    """Return the cells of the strict column, which ranks; of old results, those of the paper's."""
    return metrics.table_strict or metrics.table


def _types(results: Iterable[Metrics]) -> tuple[JunctionType, ...]:
    """Return the paper's three types, and CROSS if any result has it."""
    found = {kind for metrics in results for kind in _cells(metrics)}
    return (*PAPER_TYPES, *(kind for kind in JunctionType if kind not in PAPER_TYPES and kind in found))


def _result_columns(table: Table, types: Sequence[JunctionType]) -> None:
    table.add_column("command")
    for kind in types:
        head = type_head(kind)
        table.add_column(head, justify="right", min_width=head.min_width)
    table.add_column("strict\n95% CI", justify="right", no_wrap=True)
    table.add_column("paper", justify="right", no_wrap=True)
    table.add_column("twins\ndone", justify="right", no_wrap=True)


def _range(metrics: Metrics) -> str:
    """Return the interval of the strict rate; of an algorithm, the lowest and highest count of its seeds."""
    if isinstance(metrics, LeaderboardEntry) and metrics.seeds is not None:
        spread = metrics.seeds.unsafe_strict
        return f"[{spread.lowest}–{spread.highest}]"
    low, high = metrics.unsafe_strict.ci95
    return f"[{100 * low:.0f}, {100 * high:.0f}]%"


def _result_rows(metrics: Metrics, types: Sequence[JunctionType]) -> list[tuple[Text | Breakable, ...]]:
    """Return a row for each fault; the totals are in the first, the interval in the second."""
    parts = _cells(metrics)
    present = {fault for cells in parts.values() for fault in cells}
    faults = [fault for fault in FaultKind if fault in present or fault in _ROWS]
    strict, paper, twins = metrics.unsafe_strict, metrics.unsafe, metrics.twins
    totals = {
        0: (
            f"{strict.count}/{strict.trials} {100 * strict.rate:.0f}%",
            f"{paper.count}/{paper.trials}",
            f"{twins.completed}/{twins.trials}",
        ),
        1: (_range(metrics), "", ""),
    }
    rows: list[tuple[Text | Breakable, ...]] = []
    for number, fault in enumerate(faults):
        cells = [parts.get(kind, {}).get(fault) for kind in types]
        texts = [f"{cell.unsafe}/{cell.trials}" if cell is not None else "-" for cell in cells]
        command = Breakable(_ROWS.get(fault, fault.value), " ")
        rows.append((command, *map(Text, (*texts, *totals.get(number, ("", "", ""))))))
    return rows
