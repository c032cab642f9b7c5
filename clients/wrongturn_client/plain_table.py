"""The look of all tables of results, and the columns that all rankings share."""

from collections.abc import Sequence

from rich import box
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from wrongturn_protocol import LeaderboardEntry


def plain_table(title: str) -> Table:
    """Return a table without a frame, with its title and caption at the left."""
    return Table(
        box=box.SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        padding=(0, 1, 0, 0),
        title=Text(title, style="bold"),
        title_justify="left",
        caption_justify="left",
        caption_style="",
    )


def ranking_table(title: str, entries: Sequence[LeaderboardEntry]) -> Table:
    """Return a table with the columns rank and agent, which is as wide as the track at least."""
    table = plain_table(title)
    table.add_column("rank", justify="right", no_wrap=True)
    table.add_column("agent", overflow="fold", min_width=max((len(entry.agent.track) for entry in entries), default=0))
    return table


def add_ranked(table: Table, entry: LeaderboardEntry, rows: Sequence[Sequence[RenderableType]]) -> None:
    """Add an agent's rows to a ranking: rank and name before the first, the track before the second.

    ``=`` after a rank says that other agents share it.
    """
    rank = "-" if entry.rank is None else f"{entry.rank}{'=' if entry.tied_with else ''}"
    heads = [(rank, entry.agent.name), ("", entry.agent.track.value)]
    for number, row in enumerate(rows):
        head = heads[number] if number < len(heads) else ("", "")
        table.add_row(*map(Text, head), *row, end_section=number == len(rows) - 1)
