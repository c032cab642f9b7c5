"""Tables of figures for the terminal and for pages, and the statistics in their cells."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING, Any

from wrongturn_agents.paper import PAPER_BY_NAME, label
from wrongturn_agents.results_file import ResultsFile
from wrongturn_agents.stored_results import Collection
from wrongturn_protocol import PAPER, PaperAgent
from wrongturn_protocol.standing_rows import wilson

if TYPE_CHECKING:
    from rich.table import Table

Rows = list[tuple[str, ...]]


@dataclass(frozen=True)
class ReportTable:
    """A table of text cells. The last columns hold figures."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    """Text below the table."""
    text_columns: int = 2
    """Number of columns at the left that hold words, not figures."""

    def rich(self) -> "Table":
        """Return the table for the terminal."""
        from rich.text import Text

        from wrongturn_client.tables import plain_table

        table = plain_table(self.title)
        for number, name in enumerate(self.head):
            table.add_column(name, justify="left" if number < self.text_columns else "right")
        for number, row in enumerate(self.rows):
            # Only an agent's first row has its name: a line is drawn where the next row has one.
            last = number + 1 == len(self.rows) or bool(self.rows[number + 1][0])
            table.add_row(*(Text(cell.replace("`", "")) for cell in row), end_section=last)
        table.caption = Text(self.note)
        return table

    def markdown(self) -> str:
        """Return the table for a page, with a line break at the end."""
        if not self.rows:
            return "*Nothing is stored yet.*\n"
        rule = ["---" if number < self.text_columns else "---:" for number in range(len(self.head))]
        lines = [_line(self.head), "|" + "|".join(rule) + "|", *map(_line, self.rows)]
        return "\n".join(lines) + "\n" + (f"\n*{self.note}*\n" if self.note else "")


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def label_first(name: str, rows: Iterable[tuple[str, ...]]) -> Rows:
    """Put a name before the first row, and an empty cell before the others."""
    return [("" if number else name, *row) for number, row in enumerate(rows)]


def rows_beside_paper(
    collection: Collection,
    suite: str,
    paper_row: Callable[[PaperAgent], Sequence[str]],
    own_rows: Callable[[str], Rows],
) -> Rows:
    """Return the paper's agents, each with the rows of ours below it, and then the agents that the paper lacks.

    Args:
        collection: Our results.
        suite: Suite of the table.
        paper_row: Returns the paper's figures of an agent.
        own_rows: Returns the rows of one of our agents, each with its source in the first cell.
    """
    rows: Rows = []
    for agent in PAPER:
        paper = ("the paper", *paper_row(agent))
        rows += label_first(f"`{agent.ours}`", [paper, *own_rows(agent.ours)])
    for name in collection.agents(suite):
        if name not in PAPER_BY_NAME:
            rows += label_first(label(name), own_rows(name))
    return rows


def json_beside_paper(
    collection: Collection,
    suite: str,
    paper_figures: Callable[[PaperAgent], dict[str, Any]],
    own_figures: Callable[[ResultsFile], dict[str, Any]],
) -> dict[str, Any]:
    """Return the figures on a suite for a program, by agent: the paper's, and ours of each seed."""
    names = [*PAPER_BY_NAME, *(name for name in collection.agents(suite) if name not in PAPER_BY_NAME)]
    return {
        name: {
            "paper": paper_figures(PAPER_BY_NAME[name]) if name in PAPER_BY_NAME else None,
            "shipped_seed": collection.shipped.get(name),
            "seeds": [{"seed": seed, **own_figures(file)} for seed, file in collection.by_seed(suite, name).items()],
        }
        for name in names
    }


def with_interval(count: int, trials: int, *, percent: bool = False) -> str:
    """Return a count as text, or its rate in percent, with Wilson's interval of the rate in percent."""
    low, high = wilson(count, trials)
    shown = f"{100 * count / trials:.0f}" if percent else str(count)
    return f"{shown} ({100 * low:.0f}–{100 * high:.0f}{'' if percent else ' %'})"


def spread(values: Sequence[float]) -> str:
    """Return ``median [lowest–highest]`` of at least one value, such as one a training seed."""
    return f"{median(values):g} [{min(values):g}–{max(values):g}]"
