"""The look of all tables of results, and the columns that all rankings share."""

from collections.abc import Sequence
from typing import Final

from rich import box
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from wrongturn_protocol import Entry, Leaderboard, LeaderboardEntry

MARK: Final = "†"
"""After the name of an agent that met wrong commands in its training."""
UPLOADED: Final = "‡"
"""After the name of an agent that was handed in as a file."""


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


def notes(leaderboard: Leaderboard) -> list[str]:
    """Return why agents have no rank, a line for each reason, and whether the suite was replaced."""
    named: dict[str, list[str]] = {}
    for entry in leaderboard.entries:
        if not entry.eligible:
            named.setdefault(entry.why_not or "not eligible", []).append(entry.agent.name)
    lines = [
        f"{', '.join(names)} {'is' if len(names) == 1 else 'are'} not ranked: {why}" for why, names in named.items()
    ]
    marked = [entry.agent.name for entry in leaderboard.entries if entry.agent.trained_on_faults]
    if marked:
        lines.append(f"{MARK} met wrong commands in {'its' if len(marked) == 1 else 'their'} training.")
    if any(entry.entry is Entry.UPLOADED for entry in leaderboard.entries):
        lines.append(f"{UPLOADED} was handed in as a file, and the service drove it.")
    if leaderboard.successor is not None:
        lines.insert(0, f"{leaderboard.suite} is an old version; {leaderboard.successor} replaces it.")
    return lines


def ranking_table(title: str, entries: Sequence[LeaderboardEntry]) -> Table:
    """Return a table with the columns rank and agent, which is as wide as the track at least."""
    table = plain_table(title)
    table.add_column("rank", justify="right", no_wrap=True)
    table.add_column("agent", overflow="fold", min_width=max((len(entry.agent.track) for entry in entries), default=0))
    return table


def add_ranked(table: Table, entry: LeaderboardEntry, rows: Sequence[Sequence[RenderableType]]) -> None:
    """Add an agent's rows to a ranking, with its name, track and owner before the first three.

    ``=`` after a rank says that other agents share it, :data:`MARK` after a name that the agent met wrong commands in
    its training, :data:`UPLOADED` that it was handed in as a file. An owner of the agent's own name is left out.
    """
    rank = "-" if entry.rank is None else f"{entry.rank}{'=' if entry.tied_with else ''}"
    mark = f" {MARK}" if entry.agent.trained_on_faults else ""
    mark += f" {UPLOADED}" if entry.entry is Entry.UPLOADED else ""
    heads = [(rank, entry.agent.name + mark), ("", entry.agent.track.value)]
    if entry.seeds is not None:
        heads.append(("", f"algorithm, {entry.seeds.count} seeds"))
    elif entry.agent.owner not in {"", entry.agent.name}:
        heads.append(("", f"by {entry.agent.owner}"))
    lines = max(len(heads), len(rows))
    for number in range(lines):
        head = heads[number] if number < len(heads) else ("", "")
        row = rows[number] if number < len(rows) else ()
        table.add_row(*map(Text, head), *row, end_section=number == lines - 1)
