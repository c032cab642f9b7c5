"""Unsafe of ten with a wrong command and with "follow lane", as the paper's table II; and how those trials ended.

The strict column ranks. The paper's column is there to compare with the paper.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from lab import tables
from lab.tables import ReportTable, Rows
from wrongturn_agents.paper import ALGORITHMS, PAPER_BY_NAME, label
from wrongturn_agents.results_file import ResultsFile
from wrongturn_agents.stored_results import Collection
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_protocol import PAPER_TYPES, FaultKind, JunctionType, PaperAgent, Reaction, Verdict

Cell = tuple[JunctionType, FaultKind]

_FAULTS: Final = {FaultKind.INFEASIBLE: "wrong", FaultKind.OMISSION: "follow lane"}
"""The paper's two faults, in the order of its rows, and the command that each delivers."""
_CELLS: Final = tuple((kind, fault) for kind in PAPER_TYPES for fault in _FAULTS)
_TWINS_OF_A_DRIVER: Final = 0.9  # the share of its twins that an agent must complete, here and for a rank
_ENDS: Final = {
    "collision": {Verdict.COLLISION},
    "off road": {Verdict.OFF_ROAD},
    "stopped inside": {Verdict.STOPPED_IN_JUNCTION},
    "wrong way": {Verdict.WRONG_WAY},
    "stopped before": {Verdict.STOPPED_BEFORE_JUNCTION},
    "exit": {Verdict.EXIT_COMMANDED, Verdict.EXIT_ROUTE, Verdict.EXIT_OTHER},
}
_REACTIONS: Final = {
    Reaction.OBEYED: "obeyed",
    Reaction.OVERRODE: "overrode",
    Reaction.FROZE: "froze",
    Reaction.OTHER: "other reaction",
}
"""All reactions except ``exit``, which is an end too."""
_REMARK: Final = {True: "", False: ": cannot drive"}
_ONLY_TO_A_COMMAND: Final = {Reaction.OBEYED, Reaction.OVERRODE}
_NOTE: Final = (
    'Unsafe of 10 with a wrong command · with "follow lane", by type of junction, in the {column} column. Our rows: '
    "the shipped weights over the service, on a draw of their own, with Wilson's 95 % interval of the rate; and the "
    "median [lowest–highest] over training seeds, on the open draw. Seeds that drive completed at least 54 of their 60 "
    "twins; the others say nothing about commands. † met wrong commands in its training.{more}"
)
_NOTE_ON_PAPER: Final = " The paper has only its own column, which its rows show."
_STRICT_HEAD: Final = ("unsafe of 60, strict", "the paper's column")
_NOTE_ON_ENDS: Final = (
    "Percent of trials; stopped inside or before the junction. For a trained agent: the trials of all seeds that "
    "drive. For any other agent: all its trials. The last four columns show how the agent reacted to the fault; to "
    '"follow lane", taking an exit is a reaction too.'
)


@dataclass(frozen=True)
class UnsafeCounts:
    """Counts for one agent of one training seed."""

    strict: Mapping[Cell, int]
    """Unsafe trials by junction type and fault in the strict column."""
    paper: Mapping[Cell, int]
    """The same in the paper's column."""
    trials: int
    """Number of trials without the twins."""
    completed: int
    """Number of twins that ended in ``exit_commanded``."""
    twins: int

    @property
    def unsafe(self) -> int:
        """Number of unsafe trials in the paper's column."""
        return sum(self.paper.values())

    @property
    def unsafe_strict(self) -> int:
        """Number of unsafe trials in the strict column."""
        return sum(self.strict.values())

    @property
    def drives(self) -> bool:
        """Whether the agent completes enough twins for its unsafe trials to mean anything."""
        return self.completed >= _TWINS_OF_A_DRIVER * self.twins


def count_unsafe(file: ResultsFile) -> UnsafeCounts:
    """Count a file's unsafe trials and completed twins."""
    strict, paper = dict.fromkeys(_CELLS, 0), dict.fromkeys(_CELLS, 0)
    trials = completed = twins = 0
    drawn = file.drawn.trials
    for name, result in file.trials.items():
        trial = drawn[name]
        if trial.fault.kind is FaultKind.NONE:
            twins += 1
            completed += result.verdict is Verdict.EXIT_COMMANDED
        else:
            trials += 1
            strict[trial.junction_type, trial.fault.kind] += result.unsafe_strict
            paper[trial.junction_type, trial.fault.kind] += result.unsafe
    return UnsafeCounts(strict, paper, trials, completed, twins)


def counts_by_seed(collection: Collection, agent: str, variant: str | None = None) -> dict[int | None, UnsafeCounts]:
    """Return an agent's counts by training seed."""
    return {seed: count_unsafe(file) for seed, file in collection.by_seed(WRONG_COMMAND, agent, variant).items()}


def wrong_command_table(collection: Collection, *, strict: bool = True) -> ReportTable:
    """Return the table of unsafe trials by junction type and fault, with our figures beside the paper's.

    Args:
        collection: Our results.
        strict: Whether our cells count as in the strict column; otherwise as in the paper's.
    """
    rows = tables.rows_beside_paper(
        collection,
        WRONG_COMMAND,
        lambda agent: _paper_figures(agent, strict=strict),
        lambda name: _own_rows(collection, name, strict=strict),
    )
    totals = _STRICT_HEAD if strict else ("unsafe of 60",)
    head = ("agent", "source", *PAPER_TYPES, *totals, "twins completed")
    title = "Unsafe episodes, strict" if strict else "Unsafe episodes in the paper's column (its table II)"
    note = _NOTE.format(column="strict" if strict else "paper's", more=_NOTE_ON_PAPER if strict else "")
    return ReportTable(title, head, tuple(rows), note)


def summary_table(collection: Collection) -> ReportTable:
    """Return one line for each shipped agent of the paper's kinds, for README."""
    rows = []
    for name in ALGORITHMS:
        file = collection.of_shipped(WRONG_COMMAND, name)
        if file is None:
            continue
        counts, paper = count_unsafe(file), PAPER_BY_NAME[name]
        wrong, follow = (sum(counts.strict[kind, fault] for kind in PAPER_TYPES) for fault in _FAULTS)
        seeds = [one.unsafe_strict for seed, one in counts_by_seed(collection, name).items() if seed is not None]
        rows.append(
            (
                f"`{name}`",
                str(wrong),
                str(follow),
                tables.with_interval(counts.unsafe_strict, counts.trials),
                f"{counts.completed}/{counts.twins}",
                str(counts.unsafe),
                f"{paper.unsafe} = {sum(paper.infeasible)} + {sum(paper.omission)}",
                f"{tables.spread(seeds)} ({len(seeds)})" if seeds else "–",
            )
        )
    head = (
        "agent",
        "no such turn, of 30",
        "follow lane, of 30",
        "unsafe of 60, strict (95 %)",
        "twins completed",
        "the paper's column",
        "the paper",
        "strict over seeds",
    )
    return ReportTable("Unsafe episodes in short", head, tuple(rows), text_columns=1)


def seeds_table(collection: Collection) -> ReportTable:
    """Return the table of unsafe trials with a row for each training seed."""
    rows: Rows = []
    for name in collection.agents(WRONG_COMMAND):
        each = [
            (
                f"seed {seed}",
                *_by_type(one.strict),
                str(one.unsafe_strict),
                str(one.unsafe),
                str(one.completed) + _REMARK[one.drives],
            )
            for seed, one in counts_by_seed(collection, name).items()
            if seed is not None
        ]
        rows += tables.label_first(f"`{name}`", each)
    head = ("agent", "training", *PAPER_TYPES, *_STRICT_HEAD, "twins completed of 60")
    return ReportTable("Unsafe episodes by training seed", head, tuple(rows))


def endings_table(collection: Collection) -> ReportTable:
    """Return how the trials with a fault ended, in percent, by agent and command."""
    rows: Rows = []
    for agent in collection.agents(WRONG_COMMAND):
        files = [
            file
            for seed, file in collection.by_seed(WRONG_COMMAND, agent).items()
            if seed is None or count_unsafe(file).drives
        ]
        own: Rows = []
        for fault, command in _FAULTS.items() if files else ():
            found = [
                one
                for file in files
                for name, one in file.trials.items()
                if file.drawn.trials[name].fault.kind is fault
            ]
            ends = [sum(one.verdict in end for one in found) for end in _ENDS.values()]
            reactions = Counter(one.reaction for one in found)
            shown = [f"{100 * count / len(found):.0f}" for count in (*ends, len(found) - sum(ends))]
            for kind in _REACTIONS:
                meant = fault is FaultKind.INFEASIBLE or kind not in _ONLY_TO_A_COMMAND
                shown.append(f"{100 * reactions[kind] / len(found):.0f}" if meant else "")
            own.append((command, str(len(found)), *shown))
        rows += tables.label_first(label(agent), own)
    head = ("agent", "command", "trials", *_ENDS, "other end", *_REACTIONS.values())
    return ReportTable("How trials under a wrong command ended", head, tuple(rows), _NOTE_ON_ENDS if rows else "")


def as_json(collection: Collection) -> dict[str, Any]:
    """Return the figures for a program: for each agent, the paper's and those of each seed."""
    return tables.json_beside_paper(collection, WRONG_COMMAND, _json_of_paper, _json_of_file)


def _json_of_paper(agent: PaperAgent) -> dict[str, Any]:
    pairs = zip(agent.infeasible, agent.omission, strict=True)
    cells = dict(zip(_CELLS, (count for pair in pairs for count in pair), strict=True))
    return {"cells": _named(cells), "unsafe": agent.unsafe}


def _json_of_file(file: ResultsFile) -> dict[str, Any]:
    counts = count_unsafe(file)
    return {
        "cells": _named(counts.paper),
        "unsafe": counts.unsafe,
        "cells_strict": _named(counts.strict),
        "unsafe_strict": counts.unsafe_strict,
        "trials": counts.trials,
        "twins_completed": counts.completed,
        "drives": counts.drives,
    }


def _named(cells: Mapping[Cell, int]) -> dict[str, int]:
    return {f"{kind}.{fault}": count for (kind, fault), count in cells.items()}


def _paper_figures(agent: PaperAgent, *, strict: bool) -> list[str]:
    cells = [f"{wrong} · {follow}" for wrong, follow in zip(agent.infeasible, agent.omission, strict=True)]
    return [*cells, *([""] if strict else []), tables.with_interval(agent.unsafe, 60), ""]


def _own_rows(collection: Collection, name: str, *, strict: bool) -> Rows:
    rows: Rows = []
    shipped = collection.of_shipped(WRONG_COMMAND, name)
    if shipped is not None:
        counts = count_unsafe(shipped)
        source = "ours" if shipped.seed is None else f"ours, seed {shipped.seed}"
        shown = [tables.with_interval(one, counts.trials) for one in _totals(counts, strict=strict)]
        rows.append((source, *_by_type(_cells(counts, strict=strict)), *shown, f"{counts.completed}/{counts.twins}"))
    seeds = [counts for seed, counts in counts_by_seed(collection, name).items() if seed is not None]
    if len(seeds) > 1:
        rows.append((f"ours, {len(seeds)} seeds", *_spreads(seeds, strict=strict)))
    driving = [counts for counts in seeds if counts.drives]
    if driving and len(driving) < len(seeds):
        which = "the one that drives" if len(driving) == 1 else f"the {len(driving)} that drive"
        rows.append((which, *_spreads(driving, strict=strict)))
    return rows


def _cells(counts: UnsafeCounts, *, strict: bool) -> Mapping[Cell, int]:
    return counts.strict if strict else counts.paper


def _totals(counts: UnsafeCounts, *, strict: bool) -> tuple[int, ...]:
    """Return the totals that a row shows: the strict column and the paper's, or the paper's alone."""
    return (counts.unsafe_strict, counts.unsafe) if strict else (counts.unsafe,)


def _spreads(seeds: Sequence[UnsafeCounts], *, strict: bool) -> list[str]:
    """Return cells, totals and completed twins over seeds; for one seed, the counts themselves."""
    figures = [(*_totals(one, strict=strict), one.completed) for one in seeds]
    if len(seeds) == 1:
        return [*_by_type(_cells(seeds[0], strict=strict)), *map(str, figures[0])]
    each = [_cells(one, strict=strict) for one in seeds]
    cells = {cell: tables.spread([one[cell] for one in each]) for cell in _CELLS}
    return [*_by_type(cells), *map(tables.spread, zip(*figures, strict=True))]


def _by_type(cells: Mapping[Cell, object]) -> list[str]:
    return [" · ".join(str(cells[kind, fault]) for fault in _FAULTS) for kind in PAPER_TYPES]
