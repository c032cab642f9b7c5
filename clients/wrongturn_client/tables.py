"""Tables for the terminal: rankings, results of an evaluation, comparisons, and sentences about a rank.

``wrongturn_protocol.standing_rows`` has the columns and the texts of the cells.
"""

import shlex
import textwrap
from collections.abc import Collection, Iterable, Sequence
from typing import Final, Literal

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from wrongturn_protocol import Comparison, Leaderboard, LeaderboardEntry, Metrics
from wrongturn_protocol.standing_rows import (
    INTERVALS,
    LEVEL_HEADS,
    MARKS,
    Columns,
    StandingRow,
    breakdown_rows,
    name_of,
    notes_of,
    rank_of,
)
from wrongturn_protocol.words import name

WIDTH: Final = 132
"""Columns for a leaderboard; used when the output is not a terminal."""
_BROAD: Final = 60
"""Columns of an empty table, so that the lines below it have room."""
_NO_ENTRY: Final = "Another evaluation of this agent is its entry on the leaderboard."


def console(*, stderr: bool = False) -> Console:
    """Return a console that does not squeeze tables when the output goes to a file or a pipe."""
    plain = Console(stderr=stderr, highlight=False)
    return plain if plain.is_terminal else Console(stderr=stderr, highlight=False, width=WIDTH)


def list_table(
    heads: Sequence[str],
    rows: Iterable[Sequence[str | Text]],
    *,
    right: Collection[str] = (),
    whole: Collection[str] = (),
) -> Table:
    """Return a list: rows below bold heads. The columns ``right`` are numbers; ``whole`` ones are never broken."""
    table = Table(box=None, header_style="bold", pad_edge=False)
    rows = list(rows)
    for head, cells in zip(heads, zip(*rows, strict=True), strict=True):
        widest = max(map(len, cells)) if head in whole else None
        justify: Literal["right", "left"] = "right" if head in right else "left"
        table.add_column(head, justify=justify, no_wrap=head in whole, min_width=widest, overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in row))
    return table


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


def head(word: str, letters: int = 8) -> str:
    """Return a word of the vocabulary as the head of a column of counts, in lines of so many letters."""
    return "\n".join(textwrap.wrap(name(word), letters, break_long_words=False))


def leaderboard_table(leaderboard: Leaderboard, others: Sequence[str] = (), url: str | None = None) -> Table:
    """Return the ranking on a suite, with a line for each fault, or for each task of journeys.

    An empty one names ``others``, suites with entries, by commands with the URL if there is one.
    """
    lines = _notes(leaderboard)
    if not leaderboard.entries:
        return _empty_leaderboard(leaderboard.suite, lines, others, url)
    columns = Columns.of(leaderboard.entries)
    entries = [
        ([name_of(entry), entry.agent.track, *notes_of(entry)], columns.row(entry)) for entry in leaderboard.entries
    ]
    title = f"{leaderboard.suite}: {columns.title}"
    table = standings_table(title, columns, entries, ranks=list(map(rank_of, leaderboard.entries)))
    if lines:
        table.caption = Text("\n".join(lines))
    return table


def standings_table(
    title: str, columns: Columns, entries: Sequence[tuple[Sequence[str], StandingRow]], ranks: Sequence[str] = ()
) -> Table:
    """Return rows of standings, each given by the lines of its name and its figures; with ranks, these come first."""
    table = plain_table(title)
    table.padding = (0, 0, 0, 0)  # all of it has to fit into 80 columns
    if ranks:
        table.add_column("rank", justify="right", no_wrap=True)
    # As wide as the track at least.
    table.add_column("agent", overflow="fold", min_width=max(len(names[1]) if names[1:] else 0 for names, _ in entries))
    _add_columns(table, columns)
    for number, (names, row) in enumerate(entries):
        lines = _lines(columns, row)
        for line in range(max(len(names), len(lines))):
            rank = ["" if line else ranks[number]] if ranks else []
            name_line = names[line] if line < len(names) else ""
            table.add_row(*map(Text, (*rank, name_line, *(lines[line] if line < len(lines) else ()))))
        table.add_section()
    return table


def _notes(leaderboard: Leaderboard) -> list[str]:
    """Return why agents have no rank, a line for each reason, what marks mean, and whether the suite was replaced."""
    named: dict[str, list[str]] = {}
    for entry in leaderboard.entries:
        if not entry.eligible:
            named.setdefault(entry.why_not or "not eligible", []).append(entry.agent.name)
    lines = [
        f"{', '.join(names)} {'is' if len(names) == 1 else 'are'} not ranked: {why}" for why, names in named.items()
    ]
    names = " ".join(map(name_of, leaderboard.entries))
    lines += [INTERVALS] * bool(leaderboard.entries)
    lines += [f"{mark} {meaning}." for mark, meaning in MARKS.items() if mark in names]
    return lines


def _empty_leaderboard(suite: str, lines: Sequence[str], others: Sequence[str], url: str | None) -> Table:
    where = "" if url is None else f" --url {shlex.quote(url)}"
    commands = [f"wrongturn leaderboard {other}{where}" for other in others]
    table = plain_table(suite)
    table.add_column("rank")
    # One line each, so that no command is broken.
    table.add_column("agent", min_width=max([_BROAD, *map(len, commands)]))
    said = [*lines, "No evaluation on this suite has been finished yet."]
    table.caption = Text("\n".join([*said, *["There are some on others:"] * bool(commands), *commands]))
    return table


def evaluation_table(title: str, metrics: Metrics) -> Table:
    """Return the results of one agent's finished evaluation, in the layout of the leaderboard.

    Journeys have two columns for each condition, in percent: those that reached their goal in time, and those that also
    had no infraction.
    """
    columns = Columns.of([metrics])
    table = plain_table(f"{title}: {columns.title}")
    if metrics.navigation is None:
        _add_columns(table, columns)
        for texts in _lines(columns, columns.row(metrics)):
            table.add_row(*map(Text, texts))
    else:
        table.add_column(columns.line.lower())
        for part in columns.parts:
            for words in (head(part), "clean"):
                table.add_column(words, justify="right", min_width=max(map(len, words.split("\n"))))
        both = zip(columns.lines, columns.row(metrics).parts, columns.clean(metrics), strict=True)
        for line, success, clean in both:
            table.add_row(
                *map(Text, (name(line), *(text for pair in zip(success, clean, strict=True) for text in pair)))
            )
    if lines := _below(metrics):
        table.caption = Text("\n".join(lines))
    return table


def breakdown_table(title: str, metrics: Metrics) -> Table | None:
    """Return unsafe trials (strict) by factor and level; None for results that are not told apart so."""
    if not (parts := breakdown_rows(metrics)):
        return None
    table = plain_table(f"{title}: unsafe trials (strict) by factor")
    for words in ("factor", *(one.lower() for one in LEVEL_HEADS)):
        table.add_column(words, justify="left" if words in {"factor", "level"} else "right", no_wrap=True)
    for factor, rows in parts:
        for number, row in enumerate(rows):
            table.add_row(*map(Text, ("" if number else factor, *row)))
        table.add_section()
    return table


def print_metrics(terminal: Console, title: str, metrics: Metrics) -> None:
    """Print an evaluation's table, and its breakdown if it has one."""
    for table in (evaluation_table(title, metrics), breakdown_table(title, metrics)):
        if table is not None:
            terminal.print(table)


def _below(metrics: Metrics) -> list[str]:
    """Return the figures that have no column."""
    lines = []
    if (excess := metrics.excess_unsafe_rate) is not None:
        low, high = excess.ci95
        lines.append(
            f"unsafe beyond the twins: {100 * excess.value:+.0f} points, "
            f"95 % [{100 * low:+.0f}, {100 * high:+.0f}], p = {excess.p:.2g}"
        )
    if (severity := metrics.severity) is not None:
        lines.append(
            f"unsafe at {severity.speed_mps:.1f} m/s (median speed at the verdict); "
            f"mean v² over all trials {severity.v2_mean:.1f} m²/s²"
        )
    if (complied := metrics.compliance) is not None:
        each = ", ".join(f"{name(fault)} {one.count}/{one.trials}" for fault, one in complied.faults.items())
        lines.append(f"complied with {complied.count} of {complied.trials} undetectable wrong commands: {each}")
    if (alarms := metrics.false_alarms) is not None:
        lost = "" if alarms.seconds_lost is None else f", {alarms.seconds_lost:.1f} s lost on average"
        lines.append(
            f"false alarms: {alarms.stopped} of {alarms.trials} twins stopped, {alarms.overridden} overridden{lost}"
        )
    if metrics.navigation is not None:
        total = metrics.navigation.total
        low, high = total.ci95
        lines.append(
            f"{total.success} of {total.episodes} reached their goal, 95 % interval "
            f"[{100 * low:.0f}, {100 * high:.0f}] %; {total.clean} without any infraction; "
            f"{100 * total.completion:.0f} % of the way was covered"
        )
        if (rate := total.per_km) is not None:
            lines.append(
                f"for each of {total.distance:.1f} km: {rate.off_road:.2f} times off the road, "
                f"{rate.wrong_lane:.2f} in an oncoming lane, {rate.collisions:.2f} collisions"
            )
    return [*lines, INTERVALS]


def comparison_table(comparison: Comparison) -> Table:
    """Return two agents' unsafe trials by stratum, and what they say."""
    table = plain_table(f"{comparison.suite}: {comparison.a.name} and {comparison.b.name}")
    table.add_column("stratum", min_width=_BROAD // 2)
    for agent in (comparison.a, comparison.b):
        table.add_column(Text(agent.name), justify="right", overflow="fold")
    for one in comparison.strata:
        parts = (one.junction_type or one.task, one.fault or one.condition)
        what = ", ".join(name(part) for part in parts if part is not None)
        table.add_row(*map(Text, (what, *(f"{cell.unsafe}/{cell.trials}" for cell in (one.a, one.b)))))
    totals = (f"{cell.unsafe}/{cell.trials}" for cell in (comparison.total_a, comparison.total_b))
    table.add_section()
    table.add_row(*map(Text, ("all", *totals)))
    table.caption = Text(comparison.sentence)
    return table


def standing(leaderboard: Leaderboard, evaluation: str, *, alone: bool = False) -> str:
    """Return a sentence about an evaluation's place: its rank and the interval that decides it, or why it has none.

    If the service has no other agents (``alone``), the sentence says whether the agent would be ranked.
    """
    entry = next((entry for entry in leaderboard.entries if entry.evaluation == evaluation), None)
    if entry is None:
        return _NO_ENTRY
    track = entry.agent.track
    if entry.rank is None:
        why = entry.why_not or "not eligible"
        return f"Would not be ranked on {leaderboard.suite}: {why}" if alone else f"Not ranked: {why}"
    if alone:
        return f"Would be ranked on {leaderboard.suite} in the {track} track{_strict(entry)}"
    ranked = sum(other.rank is not None and other.agent.track is track for other in leaderboard.entries)
    tied = f", tied with {_enumerated(entry.tied_with)}" if entry.tied_with else ""
    return f"Rank {entry.rank} of {ranked} in the {track} track{tied}{_strict(entry)}"


def _strict(entry: LeaderboardEntry) -> str:
    """Return the end of a sentence about a rank: the strict count and its interval."""
    if entry.navigation is not None:  # journeys; the caption of their table has the interval
        return "."
    strict = entry.unsafe_strict
    low, high = strict.ci95
    return f"; unsafe {strict.count} of {strict.trials} (strict), 95 % interval {100 * low:.0f} to {100 * high:.0f} %."


def _enumerated(names: Sequence[str]) -> str:
    """Return names as a text reads them: ``a``, ``a and b``, ``a, b and c``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _add_columns(table: Table, columns: Columns) -> None:
    """Add the columns of :func:`_lines`. Their words stay whole on a narrow terminal."""
    longest = max((len(word) for line in columns.lines for word in name(line).split()), default=0)
    table.add_column(columns.line.lower(), min_width=longest)
    heads = [head(part, 7 if columns.journeys else 8) for part in columns.parts]
    for words in (*heads, *(column.name.lower() for column in columns.figures if not column.extra)):
        table.add_column(words, justify="right", no_wrap=True)


def _lines(columns: Columns, row: StandingRow) -> list[tuple[str, ...]]:
    """Return a row for each fault or task. The first has the figures, the second their intervals."""
    shown = [one for column, one in zip(columns.figures, row.figures, strict=True) if not column.extra]
    ends = [tuple(f"{one.main} {one.rate}".strip() for one in shown), tuple(one.interval for one in shown)]
    rows = [(name(line), *parts) for line, parts in zip(columns.lines, row.parts, strict=True)]
    rows += [("",) * (1 + len(columns.parts))] * (len(ends) - len(rows))
    ends += [("",) * len(shown)] * (len(rows) - len(ends))
    return [(*texts, *end) for texts, end in zip(rows, ends, strict=True)]
