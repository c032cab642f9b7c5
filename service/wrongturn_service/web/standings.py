"""The table of a leaderboard's page: the rows of ``wrongturn_protocol.standing_rows`` by track, each with a bar."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

from wrongturn_judge.ranking import interval
from wrongturn_protocol import PAPER, Leaderboard, LeaderboardEntry, Track
from wrongturn_protocol.standing_rows import NONE, Columns, StandingRow, name_of, notes_of, rank_of

ROWS: Final = 100
"""Agents on one page."""
WIDTH: Final = 200
"""Length of the bars' axis in pixels, from 0 to 100 %. The style sheet draws its lines at the same places."""
TICKS: Final = tuple((percent, WIDTH * percent // 100) for percent in (0, 25, 50, 75, 100))
"""The scale of the bars: percent, and pixels from the left."""
_MOST_LINES: Final = 4
"""Faults that a row has room for. A suite with more has its parts on the agents' pages alone."""
_OF_PAPER: Final = {"wrong-command", "navigation"}
"""Suites with figures of the paper."""


@dataclass(frozen=True)
class Bar:
    """A rate with its intervals, in pixels along the axis."""

    value: float
    wide: tuple[float, float]
    """The 95 % interval, or the range over training seeds: a thin line."""
    narrow: tuple[float, float] | None
    """The 83.4 % interval, which decides the rank: a thick line. None if nothing is ranked by it."""
    style: str
    """Class in the style sheet: ``unsafe``, ``success`` or ``reference``."""

    @classmethod
    def of(cls, row: StandingRow, style: str) -> "Bar | None":
        """Return the bar of a row; None for a row without a rate."""
        if row.rate is None:
            return None
        low, high, *narrow = (round(0.5 + WIDTH * rate, 1) for rate in (*row.wide, *(row.narrow or ())))
        return cls(round(0.5 + WIDTH * row.rate, 1), (low, high), (narrow[0], narrow[1]) if narrow else None, style)


@dataclass(frozen=True)
class Line:
    """One agent, algorithm, or agent of the paper."""

    rank: str
    name: str
    agent: str | None
    """Id of the agent; None if it has no page."""
    notes: tuple[str, ...]
    """Short facts below the name."""
    why_not: str | None
    """Why an agent has no rank."""
    bar: Bar | None
    row: StandingRow


@dataclass(frozen=True)
class Group:
    """Lines of one track."""

    title: str
    lines: tuple[Line, ...]


@dataclass(frozen=True)
class First:
    """The agents of rank 1 in one track."""

    track: str
    names: tuple[str, ...]
    ranked: int
    """Number of agents with a rank in this track."""


@dataclass(frozen=True)
class Standings:
    """A leaderboard's table, or a page of it."""

    columns: Columns
    groups: tuple[Group, ...]
    paper: Group | None
    """The paper's agents, for comparison."""
    first: tuple[First, ...]
    """The agents of rank 1, by track."""
    shown: int
    """Number of entries that pass the filter."""
    page: int
    pages: int


def standings(
    board: Leaderboard, entries: Sequence[LeaderboardEntry], page: int, *, journeys: bool, paper: bool
) -> Standings:
    """Return one page of a leaderboard.

    Args:
        board: The leaderboard.
        entries: Those of its entries that pass the filter.
        page: Number of the page, from 1.
        journeys: Whether the suite is one of journeys.
        paper: Whether the paper's agents are shown, if the suite has figures of the paper.
    """
    # Rows over training seeds are never ranked: they stand in a group of their own, after all agents.
    here = sorted(entries, key=lambda entry: entry.seeds is not None)[(page - 1) * ROWS : page * ROWS]
    columns = Columns.of(board.entries, journeys=journeys)
    if not journeys and len(columns.lines) > _MOST_LINES:
        columns = replace(columns, lines=(), parts=())
    theirs: tuple[Line, ...] = ()
    if paper and board.suite.partition("@")[0] in _OF_PAPER:
        rows = ((agent, columns.row_of_paper(agent)) for agent in PAPER)
        theirs = tuple(
            Line(NONE, agent.title, None, (f"the design of {agent.ours}",), None, Bar.of(row, "reference"), row)
            for agent, row in rows
        )
    return Standings(
        columns=columns,
        groups=tuple(_grouped([(entry, _line(entry, columns)) for entry in here])),
        paper=Group("The paper's agents, in CARLA", theirs) if theirs else None,
        first=tuple(_first(board)),
        shown=len(entries),
        page=page,
        pages=page_count(entries),
    )


def page_count(entries: Sequence[LeaderboardEntry]) -> int:
    """Return how many pages a table has; an empty one has one."""
    return max(1, -(-len(entries) // ROWS))


def _first(board: Leaderboard) -> Iterable[First]:
    for track in Track:
        ranked = [entry for entry in board.entries if entry.rank is not None and entry.agent.track is track]
        if ranked:
            names = tuple(entry.agent.name for entry in ranked if entry.rank == 1)
            yield First(f"{track} track", names, len(ranked))


def _grouped(found: Sequence[tuple[LeaderboardEntry, Line]]) -> Iterable[Group]:
    for track in Track:
        lines = tuple(line for entry, line in found if entry.agent.track is track and entry.seeds is None)
        if lines:
            yield Group(f"{track.capitalize()} track", lines)
    algorithms = tuple(line for entry, line in found if entry.seeds is not None)
    if algorithms:
        yield Group("Our algorithms, median over training seeds; not ranked", algorithms)


def _line(entry: LeaderboardEntry, columns: Columns) -> Line:
    row, agent = columns.row(entry), entry.agent
    if columns.journeys:
        worst, best = interval(entry)
        row = replace(row, narrow=(1 - best, 1 - worst))
    return Line(
        rank=rank_of(entry),
        name=name_of(entry),
        agent=agent.id if entry.seeds is None else None,
        notes=(agent.kind.value if entry.seeds is None else f"{agent.track} track", *notes_of(entry)),
        why_not=entry.why_not if entry.seeds is None else None,
        bar=Bar.of(row, "success" if columns.journeys else "unsafe"),
        row=row,
    )
