"""A table of figures, for the terminal and for a page."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table


@dataclass(frozen=True)
class ReportTable:
    """Plain text in rows; the columns after the first ones are of figures."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    """Lines below it."""
    words: int = 2
    """Columns of words at the left, before those of figures."""

    def rich(self) -> "Table":
        """It as the terminal shows it."""
        from rich.text import Text  # noqa: PLC0415 - the program's help starts without it

        from wrongturn_client.plain_table import plain_table  # noqa: PLC0415

        table = plain_table(self.title)
        for number, name in enumerate(self.head):
            table.add_column(name, justify="left" if number < self.words else "right")
        for number, row in enumerate(self.rows):
            # What belongs to one agent stands together: its name is in the first of its rows alone.
            last = number + 1 == len(self.rows) or bool(self.rows[number + 1][0])
            table.add_row(*(Text(cell.replace("`", "")) for cell in row), end_section=last)
        table.caption = Text("\n".join(self.notes))
        return table

    def markdown(self) -> str:
        """It as a page shows it, ending in a line break."""
        rule = ["---" if number < self.words else "---:" for number in range(len(self.head))]
        lines = [_row(self.head), "|" + "|".join(rule) + "|", *map(_row, self.rows)]
        for note in self.notes:
            lines += ["", f"*{note}*"]
        return "\n".join(lines) + "\n"


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
