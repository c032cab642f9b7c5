"""The table of a leaderboard's page: the rows of ``wrongturn_protocol.standing_rows``, by track."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from wrongturn_judge.ranking import interval
from wrongturn_protocol import PAPER, Leaderboard, LeaderboardEntry, Track
from wrongturn_protocol.standing_rows import NONE, Columns, StandingRow, name_of, notes_of, rank_of

ROWS: Final = 100
"""Agents on one page."""
_MOST_LINES: Final = 4
"""Faults that a row has room for. A suite with more has its parts on the agents' pages alone."""
_OF_PAPER: Final = {"wrong-command", "navigation"}
"""Suites with figures of the paper."""


_ALGORITHMS: Final = "Our algorithms, median over training seeds; not ranked"
_NOTES: Final = {
    _ALGORITHMS: "An algorithm was trained several times, each time from another seed, and all drove the open draw. "
    "Its row has the median seed, and its line spans the seeds. The agent of the same name is one of these, the "
    "shipped one: it drove a draw of its own and has a rank."
}
_PAPERS_NOTE: Final = (
    "Carton et al. drove their agents in CARLA and judged by eye. Those of the same name here have the paper's design "
    "and were trained on our towns. So compare only which junctions are hard, and the order of the agents."
)


class Line(NamedTuple):
    """One agent, algorithm, or agent of the paper."""

    row: StandingRow
    name: str
    notes: tuple[str, ...]
    """Short facts below the name."""
    rank: str = NONE
    agent: str | None = None
    """Id of the agent; None if it has no page."""
    why_not: str | None = None
    """Why an agent has no rank."""


class Group(NamedTuple):
    """Lines of one track, or of what is not ranked."""

    title: str
    lines: tuple[Line, ...]
    note: str = ""
    """How the lines differ from an agent of the same name; empty for agents. Such a group is folded."""
    of_paper: bool = False


class First(NamedTuple):
    """The agents of rank 1 in one track."""

    track: str
    names: tuple[str, ...]
    figure: str
    """The figure of the first of them that ranks, with its 95 % interval."""
    ranked: int
    """Number of agents with a rank in this track."""


@dataclass(frozen=True)
class Standings:
    """A leaderboard's table, or a page of it."""

    columns: Columns
    ranked: tuple[Group, ...]
    """Agents, by track."""
    folded: tuple[Group, ...]
    """Algorithms over their training seeds and the paper's agents, for comparison."""
    first: tuple[First, ...]
    """The agents of rank 1, by track."""
    shown: int
    """Number of entries that pass the filter."""
    page: int
    pages: int


def standings(
    board: Leaderboard, entries: Sequence[LeaderboardEntry], page: int, *, journeys: bool, paper: bool
) -> Standings:
    """Return one page of a leaderboard, from 1, with those of its entries that pass the filter.

    ``journeys`` says whether it is of a suite of journeys, ``paper`` whether the paper's agents are shown where the
    suite has figures of the paper.
    """
    # Rows over training seeds are never ranked: they stand in a group of their own, after all agents.
    here = sorted(entries, key=lambda entry: entry.seeds is not None)[(page - 1) * ROWS : page * ROWS]
    columns = Columns.of(board.entries, journeys=journeys)
    if not journeys and len(columns.lines) > _MOST_LINES:
        columns = replace(columns, lines=(), parts=())
    theirs: tuple[Line, ...] = ()
    if paper and of_paper(board.suite):
        theirs = tuple(
            Line(columns.row_of_paper(agent), agent.title, (f"the design of {agent.ours}",)) for agent in PAPER
        )
    groups = list(_groups(here, columns))
    if theirs:
        groups.append(Group("The paper's agents, in CARLA", theirs, _PAPERS_NOTE, of_paper=True))
    return Standings(
        columns=columns,
        ranked=tuple(group for group in groups if not group.note),
        folded=tuple(group for group in groups if group.note),
        first=tuple(_first(board, columns)),
        shown=len(entries),
        page=page,
        pages=page_count(entries),
    )


def of_paper(suite: str) -> bool:
    """Return whether the paper has figures of a suite, by its id."""
    return suite.partition("@")[0] in _OF_PAPER


def page_count(entries: Sequence[LeaderboardEntry]) -> int:
    """Return how many pages a table has; an empty one has one."""
    return max(1, -(-len(entries) // ROWS))


def _first(board: Leaderboard, columns: Columns) -> Iterator[First]:
    for track in Track:
        ranked = [entry for entry in board.entries if entry.rank is not None and entry.agent.track is track]
        if ranked:
            best = [entry for entry in ranked if entry.rank == 1]
            figure = columns.row(best[0]).figures[0]
            yield First(f"{track} track", tuple(map(name_of, best)), f"{figure.main}, {figure.interval}", len(ranked))


def _groups(entries: Sequence[LeaderboardEntry], columns: Columns) -> Iterator[Group]:
    groups: dict[str, list[Line]] = {f"{track.capitalize()} track": [] for track in Track}
    for entry in entries:
        agent, row = entry.agent, columns.row(entry)
        if columns.journeys:
            worst, best = interval(entry)
            row = replace(row, narrow=(1 - best, 1 - worst))
        if entry.seeds is not None:
            title = _ALGORITHMS
            line = Line(row, name_of(entry), (f"{agent.track} track", *notes_of(entry)))
        else:
            title = f"{agent.track.capitalize()} track"
            notes = (agent.kind.value, *notes_of(entry))
            line = Line(row, name_of(entry), notes, rank_of(entry), agent.id, entry.why_not)
        groups.setdefault(title, []).append(line)
    return (Group(title, tuple(lines), _NOTES.get(title, "")) for title, lines in groups.items() if lines)
