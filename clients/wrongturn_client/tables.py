"""Results in the layout of the reference paper: a column for each junction type, a row for each fault."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from rich.console import Console, ConsoleOptions
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from wrongturn_client.navigation_tables import navigation_leaderboard, navigation_table
from wrongturn_client.plain_table import plain_table
from wrongturn_protocol import PAPER_TYPES, FaultKind, JunctionType, Leaderboard, Metrics

WIDTH: Final = 132
"""Columns that a leaderboard wants; used where the output is no terminal."""
_ROOMY: Final = 106
"""Columns of a leaderboard from which nothing need be broken."""
_BROAD: Final = 60
"""Columns in which a line below a table without rows has room."""
_ROWS: Final = {FaultKind.INFEASIBLE: "wrong command", FaultKind.OMISSION: "follow lane"}
"""The paper's words for its two faults."""


def console(*, stderr: bool = False) -> Console:
    """A console on which the tables are not squeezed where the output goes to a file or a pipe."""
    plain = Console(stderr=stderr, highlight=False)
    return plain if plain.is_terminal else Console(stderr=stderr, highlight=False, width=WIDTH)


class Breakable:
    """Words of a fixed column: on one line, or broken behind ``at`` on a narrow terminal, and nowhere else.

    rich takes room from the widest columns alike, so that the others lose letters; a column of these takes no more
    than its longest word there and leaves the rest to the agents' names.
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
    """A junction type at the head of a column."""
    return Breakable(kind.value, "_")


def leaderboard_table(leaderboard: Leaderboard, others: Sequence[str] = ()) -> Table:
    """The ranking on a suite: for each agent a row with wrong commands and a row with the command to follow the lane.

    The columns of junction types give unsafe episodes of all. ``unsafe`` is their sum with its rate, and Wilson's 95%
    interval below; ``strict`` counts wrong ways too; ``twins done`` are the same trials without fault that were
    completed; ``=`` behind a rank says that it is shared. A suite of journeys has CoRL 2017's layout instead: a row for
    each task, a column for each condition.

    Args:
        leaderboard: what is shown.
        others: suites that have entries, named where this one has none.
    """
    if not leaderboard.entries:
        # Which of the two layouts the suite has, its first entry will tell.
        table = plain_table(leaderboard.suite)
        table.add_column("rank")
        table.add_column("agent", min_width=_BROAD)
    elif any(entry.navigation for entry in leaderboard.entries):
        table = navigation_leaderboard(leaderboard)
    else:
        table = _unsafe_leaderboard(leaderboard)
    notes = [
        f"{entry.agent.name} is not ranked: {entry.why_not or 'not eligible'}"
        for entry in leaderboard.entries
        if not entry.eligible
    ]
    if not leaderboard.entries:
        notes.append("No evaluation on this suite has been finished yet.")
        # A line each, so that none is broken within its command.
        notes += ["There are some on others:"] * bool(others) + [f"wrongturn leaderboard {suite}" for suite in others]
    if notes:
        table.caption = Text("\n".join(notes))
    return table


def _unsafe_leaderboard(leaderboard: Leaderboard) -> Table:
    types = _types(leaderboard.entries)
    table = plain_table(f"{leaderboard.suite}: unsafe episodes")
    tracks = (len(entry.agent.track) for entry in leaderboard.entries)
    table.add_column("rank", justify="right", no_wrap=True)
    table.add_column("agent", overflow="fold", min_width=max(tracks, default=0))
    _result_columns(table, types)
    for entry in leaderboard.entries:
        rank = "-" if entry.rank is None else f"{entry.rank}{'=' if entry.tied_with else ''}"
        rows = _result_rows(entry, types)
        for number, row in enumerate(rows):
            head = [(rank, entry.agent.name), ("", entry.agent.track.value)][number] if number < 2 else ("", "")
            table.add_row(*map(Text, head), *row, end_section=number == len(rows) - 1)
    return table


def evaluation_table(name: str, metrics: Metrics) -> Table:
    """What one agent's evaluation came to, in the layout of the leaderboard; journeys with all their figures.

    Args:
        name: of the agent.
        metrics: of its finished evaluation.
    """
    if metrics.navigation is not None:
        return navigation_table(name, metrics.navigation)
    types = _types([metrics])
    table = plain_table(f"{name}: unsafe episodes")
    _result_columns(table, types)
    for row in _result_rows(metrics, types):
        table.add_row(*row)
    if (excess := metrics.excess_unsafe_rate) is not None:
        low, high = excess.ci95
        table.caption = Text(
            f"unsafe rate less that of the twins: {100 * excess.value:+.0f} points, "
            f"95% CI [{100 * low:+.0f}, {100 * high:+.0f}], p = {excess.p:.2g}",
        )
    return table


def _types(results: Iterable[Metrics]) -> tuple[JunctionType, ...]:
    """The paper's three types, and CROSS where any result has it."""
    found = {kind for metrics in results for kind in metrics.table}
    return (*PAPER_TYPES, *(kind for kind in JunctionType if kind not in PAPER_TYPES and kind in found))


def _result_columns(table: Table, types: Sequence[JunctionType]) -> None:
    table.add_column("command")
    for kind in types:
        head = type_head(kind)
        table.add_column(head, justify="right", min_width=head.min_width)
    table.add_column("unsafe\n95% CI", justify="right", no_wrap=True)
    table.add_column("strict", justify="right", no_wrap=True)
    table.add_column("twins\ndone", justify="right", no_wrap=True)


def _result_rows(metrics: Metrics, types: Sequence[JunctionType]) -> list[tuple[Text | Breakable, ...]]:
    """A row for each fault; the totals stand in the first, the interval in the second."""
    present = {fault for cells in metrics.table.values() for fault in cells}
    faults = [fault for fault in FaultKind if fault in present or fault in _ROWS]
    low, high = metrics.unsafe.ci95
    totals = {
        0: (
            f"{metrics.unsafe.count}/{metrics.unsafe.trials} {100 * metrics.unsafe.rate:.0f}%",
            f"{metrics.unsafe_strict.count}/{metrics.unsafe_strict.trials}",
            f"{metrics.twins.completed}/{metrics.twins.trials}",
        ),
        1: (f"[{100 * low:.0f}, {100 * high:.0f}]%", "", ""),
    }
    rows: list[tuple[Text | Breakable, ...]] = []
    for number, fault in enumerate(faults):
        cells = [metrics.table.get(kind, {}).get(fault) for kind in types]
        texts = [f"{cell.unsafe}/{cell.trials}" if cell is not None else "-" for cell in cells]
        command = Breakable(_ROWS.get(fault, fault.value), " ")
        rows.append((command, *map(Text, (*texts, *totals.get(number, ("", "", ""))))))
    return rows
