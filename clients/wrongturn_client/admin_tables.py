"""What ``wrongturn admin`` prints: tables, and what there is in words. Slow imports wait until a table is printed."""

from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from wrongturn_protocol.administration import Contents

_FREE: Final = frozenset({"contact", "reason", "rows", "why"})
"""Columns of tables with long texts, which are broken."""
_BROADEST: Final = 1000


def cell(field: str, value: object) -> str:
    """Return a field's value as a table shows it."""
    if field == "created":
        return minute(str(value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "" if value is None else str(value)


def minute(time: str) -> str:
    """Return an ISO 8601 time in UTC as tables show it, such as ``2026-11-22 16:13``."""
    return time[:16].replace("T", " ")


def words_of(contents: "Contents") -> str:
    """Return what there is in words, such as ``1 agent, 12 episodes, 3.4 MB``."""
    counts = contents.model_dump(exclude={"bytes"})
    parts = [f"{number} {kind if number != 1 else _one(kind)}" for kind, number in counts.items() if number]
    if contents.bytes:
        parts.append(f"{contents.bytes / 1e6:.1f} MB" if contents.bytes >= 1e5 else f"{contents.bytes} bytes")
    return ", ".join(parts) or "nothing"


def _one(kind: str) -> str:
    return {"replies": "reply", "trajectories": "trajectory", "results": "record of results"}.get(kind, kind[:-1])


def print_table(heads: Any, rows: Any) -> None:
    """Print rows of texts below their heads."""
    from rich.measure import Measurement  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415
    from rich.text import Text  # noqa: PLC0415

    from wrongturn_client.tables import console  # noqa: PLC0415

    table = Table(box=None, header_style="bold", pad_edge=False)
    for head, cells in zip(heads, zip(*rows, strict=True), strict=True):
        whole = head not in _FREE
        table.add_column(head, no_wrap=whole, min_width=max(map(len, cells)) if whole else None, overflow="fold")
    for row in rows:
        table.add_row(*map(Text, row))
    screen = console()
    # What can be copied, such as an id, is never broken: on a narrow terminal the lines are longer than it is.
    broad = screen.options.update(max_width=_BROADEST)
    screen.width = max(screen.width, Measurement.get(screen, broad, table).minimum)
    screen.print(table)
