"""A leaderboard as CSV: a row for each agent."""

import csv
import io
from typing import Any

from wrongturn_protocol import Condition, FaultKind, JunctionType, Leaderboard, LeaderboardEntry, Task

_CELLS = tuple((kind, fault) for kind in JunctionType for fault in FaultKind)
_ROUTES = tuple((task, condition) for task in Task for condition in Condition)


def leaderboard_csv(board: Leaderboard) -> str:
    """Return a leaderboard as CSV (RFC 4180, with line feeds), in the order of its entries.

    Columns of junction types and faults, or of tasks and conditions, are those that some entry has. A cell is empty
    where an entry has no such figure; truths are 0 and 1.
    """
    rows = [_row(entry) for entry in board.entries]
    present = {name for row in rows for name in row}
    columns = [name for name in (*_NAMES, *map(_cell_name, _CELLS), *map(_route_name, _ROUTES)) if name in present]
    out = io.StringIO()
    writer = csv.DictWriter(out, columns or _NAMES, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


def _row(entry: LeaderboardEntry) -> dict[str, Any]:
    strict, paper, twins, excess = entry.unsafe_strict, entry.unsafe, entry.twins, entry.excess_unsafe_rate
    low83, high83 = strict.ci83 or (None, None)
    seeds = entry.seeds
    figures = (
        *(entry.rank, entry.agent.name, entry.agent.owner, entry.agent.track.value, entry.agent.kind.value),
        *(int(entry.agent.trained_on_faults), entry.entry and entry.entry.value, int(entry.eligible), entry.why_not),
        *(";".join(entry.tied_with), strict.trials, strict.count, strict.rate, *strict.ci95, low83, high83),
        *(paper.count, paper.rate, *paper.ci95, twins.trials, twins.completed, twins.unsafe),
        *((excess.value, *excess.ci95, excess.p) if excess else (None,) * 4),
        *(entry.aborted, seeds and seeds.count, entry.agent.id, entry.evaluation),
    )
    return {
        **dict(zip(_NAMES, figures, strict=True)),
        **{
            _cell_name((kind, FaultKind(fault))): cell.unsafe
            for kind, cells in (entry.table_strict or {}).items()
            for fault, cell in cells.items()
        },
        **{
            _route_name((task, condition)): count.success
            for task, counts in (entry.navigation.table if entry.navigation else {}).items()
            for condition, count in counts.items()
        },
    }


_NAMES = (
    *("rank", "agent", "owner", "track", "kind"),
    *("trained_on_faults", "entry", "eligible", "why_not"),
    *("tied_with", "trials", "unsafe_strict", "unsafe_strict_rate", "ci95_low", "ci95_high", "ci83_low", "ci83_high"),
    *("unsafe_paper", "unsafe_paper_rate", "paper_ci95_low", "paper_ci95_high"),
    *("twins", "twins_completed", "twins_unsafe"),
    *("excess", "excess_ci95_low", "excess_ci95_high", "excess_p"),
    *("aborted", "seeds", "agent_id", "evaluation"),
)


def _cell_name(cell: tuple[JunctionType, FaultKind]) -> str:
    """Return the column of unsafe trials (strict) of a type and fault."""
    return f"unsafe_strict_{cell[0]}_{cell[1]}"


def _route_name(route: tuple[Task, Condition]) -> str:
    """Return the column of completed journeys of a task and condition."""
    return f"arrived_{route[0]}_{route[1]}"
