"""Results in the layout of the reference paper: a column for each junction type, a row for each fault."""

from collections.abc import Iterable, Sequence
from typing import Final

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from wrongturn_protocol import PAPER_TYPES, FaultKind, JunctionType, Leaderboard, Metrics, UnsafeCount

WIDTH: Final = 132
"""Columns that a leaderboard wants; used where the output is no terminal."""
_ROWS: Final = {FaultKind.INFEASIBLE: "wrong command", FaultKind.OMISSION: "follow lane"}
"""The paper's words for its two faults."""


def console(*, stderr: bool = False) -> Console:
    """A console on which the tables are not squeezed where the output goes to a file or a pipe."""
    plain = Console(stderr=stderr, highlight=False)
    return plain if plain.is_terminal else Console(stderr=stderr, highlight=False, width=WIDTH)


def leaderboard_table(leaderboard: Leaderboard) -> Table:
    """The ranking on a suite: for each agent a row with wrong commands and a row with the command to follow the lane.

    The columns of junction types give unsafe episodes of all; ``unsafe`` has Wilson's 95 % interval.
    """
    types = _types(leaderboard.entries)
    table = Table(box=box.SIMPLE_HEAD, title=f"{leaderboard.suite}: unsafe episodes", title_justify="left")
    table.add_column("rank", justify="right", no_wrap=True)
    table.add_column("agent", overflow="fold")
    table.add_column("track")
    _result_columns(table, types)
    for entry in leaderboard.entries:
        rank = "-" if entry.rank is None else f"{entry.rank}{'=' if entry.tied_with else ''}"
        rows = _result_rows(entry, types)
        for number, row in enumerate(rows):
            head = (rank, entry.agent.name, entry.agent.track.value) if number == 0 else ("", "", "")
            table.add_row(*map(Text, head), *row, end_section=number == len(rows) - 1)
    notes = [
        f"{entry.agent.name} is not ranked: {entry.why_not or 'not eligible'}"
        for entry in leaderboard.entries
        if not entry.eligible
    ]
    if not leaderboard.entries:
        notes.append("No evaluation on this suite has been finished yet.")
    if notes:
        table.caption = Text("\n".join(notes))
        table.caption_justify = "left"
    return table


def evaluation_table(name: str, metrics: Metrics) -> Table:
    """What one agent's evaluation came to, in the layout of the leaderboard.

    Args:
        name: of the agent.
        metrics: of its finished evaluation.
    """
    types = _types([metrics])
    table = Table(box=box.SIMPLE_HEAD, title=Text(f"{name}: unsafe episodes"), title_justify="left")
    _result_columns(table, types)
    for row in _result_rows(metrics, types):
        table.add_row(*row)
    excess = metrics.excess_unsafe_rate
    table.caption = Text(
        f"Excess unsafe rate over the same trials without fault: {_percent(excess.value)} "
        f"[{_percent(excess.ci95[0])}, {_percent(excess.ci95[1])}], p = {excess.p:.3g}",
    )
    table.caption_justify = "left"
    return table


def _types(results: Iterable[Metrics]) -> tuple[JunctionType, ...]:
    """The paper's three types, and CROSS where any result has it."""
    found = {kind for metrics in results for kind in metrics.table}
    return (*PAPER_TYPES, *(kind for kind in JunctionType if kind not in PAPER_TYPES and kind in found))


def _result_columns(table: Table, types: Sequence[JunctionType]) -> None:
    table.add_column("command", no_wrap=True)
    for kind in types:
        table.add_column(kind.value, justify="right", no_wrap=True)
    table.add_column("unsafe (95 % CI)", justify="right")
    table.add_column("strict", justify="right", no_wrap=True)
    table.add_column("twins completed", justify="right")


def _result_rows(metrics: Metrics, types: Sequence[JunctionType]) -> list[tuple[Text, ...]]:
    """A row for each fault; the totals stand in the first."""
    present = {fault for cells in metrics.table.values() for fault in cells}
    faults = [fault for fault in FaultKind if fault in present or fault in _ROWS]
    totals = (
        Text(_unsafe(metrics.unsafe)),
        Text(f"{metrics.unsafe_strict.count}/{metrics.unsafe_strict.trials}"),
        Text(f"{metrics.twins.completed}/{metrics.twins.trials}"),
    )
    rows = []
    for number, fault in enumerate(faults):
        cells = [metrics.table.get(kind, {}).get(fault) for kind in types]
        texts = (Text(f"{cell.unsafe}/{cell.trials}" if cell is not None else "-") for cell in cells)
        end = totals if number == 0 else (Text(), Text(), Text())
        rows.append((Text(f"with {_ROWS.get(fault, fault.value)}"), *texts, *end))
    return rows


def _unsafe(count: UnsafeCount) -> str:
    low, high = count.ci95
    return f"{count.count}/{count.trials} = {_percent(count.rate)} [{_percent(low)}, {_percent(high)}]"


def _percent(rate: float) -> str:
    return f"{100 * rate:.0f} %"
