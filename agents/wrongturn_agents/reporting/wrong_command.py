"""The paper's table II: unsafe of ten with a wrong command and with "follow lane", by type of junction."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from wrongturn_agents.reporting.collection import Collection
from wrongturn_agents.reporting.paper import LIKE, PAPER, PaperAgent
from wrongturn_agents.reporting.report_table import ReportTable
from wrongturn_agents.reporting.results_file import ResultsFile
from wrongturn_agents.reporting.spread import Spread, with_interval
from wrongturn_agents.suites import WRONG_COMMAND, SuiteTrials
from wrongturn_protocol import PAPER_TYPES, FaultKind, JunctionType, Verdict

FAULTS: Final = (FaultKind.INFEASIBLE, FaultKind.OMISSION)
"""The paper's two, in the order of its rows."""
DRIVES: Final = 0.9
"""Share of its twins that an agent must complete, as for a rank, for its unsafe trials to say anything."""
CELLS: Final = tuple((kind, fault) for kind in PAPER_TYPES for fault in FAULTS)
_NOTE: Final = (
    'Unsafe of 10 with a wrong command · with "follow lane", by the junction\'s type. Ours: the shipped weights with '
    "Wilson's 95 % interval of the rate, and median [least–most] over training seeds. Those that drive completed "
    "54 of their 60 twins or more; the others say nothing about commands."
)


@dataclass(frozen=True)
class UnsafeCounts:
    """What one agent of one seed came to."""

    cells: Mapping[tuple[JunctionType, FaultKind], int]
    """Unsafe, by :data:`CELLS`."""
    trials: int
    """Without twins."""
    completed: int
    """Twins that ended in ``exit_commanded``."""
    twins: int

    @property
    def unsafe(self) -> int:
        """Of all trials."""
        return sum(self.cells.values())

    @property
    def drives(self) -> bool:
        """Whether it completes enough of its twins to say anything."""
        return self.completed >= DRIVES * self.twins


def count_unsafe(file: ResultsFile, suite: SuiteTrials) -> UnsafeCounts:
    """Count a file's unsafe trials and completed twins."""
    cells = dict.fromkeys(CELLS, 0)
    trials = completed = twins = 0
    for name, result in file.trials.items():
        trial = suite.trials[name]
        if trial.fault.kind is FaultKind.NONE:
            twins += 1
            completed += result.verdict is Verdict.EXIT_COMMANDED
        else:
            trials += 1
            cells[trial.junction_type, trial.fault.kind] += result.verdict.unsafe
    return UnsafeCounts(cells, trials, completed, twins)


def by_seed(collection: Collection, agent: str, variant: str | None = None) -> dict[int | None, UnsafeCounts]:
    """An agent's counts by training seed."""
    files = collection.of(WRONG_COMMAND, agent, variant)
    return {seed: count_unsafe(file, collection.suite_of(WRONG_COMMAND)) for seed, file in files.items()}


def wrong_command_table(collection: Collection) -> ReportTable:
    """Ours beside the paper's; the paper's rows alone where nothing is stored."""
    rows: list[tuple[str, ...]] = []
    for agent in PAPER:
        if agent.ours is None:
            rows.append((agent.title, *_paper_row(agent)))
        else:
            rows += _named(f"`{agent.ours}`", [_paper_row(agent), *_own_rows(collection, agent.ours)])
    for name in collection.agents(WRONG_COMMAND):
        if name not in LIKE:
            rows += _named(f"`{name}`", _own_rows(collection, name))
    types = (kind.value for kind in PAPER_TYPES)
    return ReportTable(
        "Unsafe episodes (the paper's table II)",
        ("agent", "figures of", *types, "unsafe of 60", "twins completed"),
        tuple(rows),
        (_NOTE,),
    )


def seeds_table(collection: Collection) -> ReportTable:
    """Each seed by itself."""
    rows: list[tuple[str, ...]] = []
    for name in LIKE:
        counts = by_seed(collection, name)
        each = [
            (
                f"seed {seed}",
                *_cells(one),
                str(one.unsafe),
                f"{one.completed}" if one.drives else f"{one.completed}: cannot drive",
            )
            for seed, one in counts.items()
        ]
        rows += _named(f"`{name}`", each)
    types = (kind.value for kind in PAPER_TYPES)
    head = ("agent", "training", *types, "unsafe of 60", "twins completed of 60")
    return ReportTable("Unsafe episodes by training seed", head, tuple(rows))


def as_json(collection: Collection) -> dict[str, Any]:
    """The same figures for a program: by agent, the paper's and each seed's."""
    names = [*LIKE, *(name for name in collection.agents(WRONG_COMMAND) if name not in LIKE)]
    return {
        name: {
            "paper": {"cells": _keyed({cell: LIKE[name].cell(*cell) for cell in CELLS}), "unsafe": LIKE[name].unsafe}
            if name in LIKE
            else None,
            "shipped_seed": collection.shipped.get(name),
            "seeds": [
                {
                    "seed": seed,
                    "cells": _keyed(one.cells),
                    "unsafe": one.unsafe,
                    "trials": one.trials,
                    "twins_completed": one.completed,
                    "drives": one.drives,
                }
                for seed, one in by_seed(collection, name).items()
            ],
        }
        for name in names
    }


def _keyed(cells: Mapping[tuple[JunctionType, FaultKind], int]) -> dict[str, int]:
    return {f"{kind}.{fault}": count for (kind, fault), count in cells.items()}


def _named(name: str, rows: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """The rows of one agent, its name before the first."""
    return [("" if number else name, *row) for number, row in enumerate(rows)]


def _paper_row(agent: PaperAgent) -> tuple[str, ...]:
    cells = (f"{wrong} · {follow}" for wrong, follow in zip(agent.infeasible, agent.omission, strict=True))
    return ("the paper", *cells, with_interval(agent.unsafe, 60), "")


def _own_rows(collection: Collection, name: str) -> list[tuple[str, ...]]:
    rows = []
    shipped = collection.of_shipped(WRONG_COMMAND, name)
    if shipped is not None:
        counts = count_unsafe(shipped, collection.suite_of(WRONG_COMMAND))
        whose = "ours" if shipped.seed is None else f"ours, seed {shipped.seed}"
        total = with_interval(counts.unsafe, counts.trials)
        rows.append((whose, *_cells(counts), total, f"{counts.completed}/{counts.twins}"))
    seeds = [counts for seed, counts in by_seed(collection, name).items() if seed is not None]
    if len(seeds) > 1:
        rows.append((f"ours, {len(seeds)} seeds", *_spreads(seeds)))
    driving = [counts for counts in seeds if counts.drives]
    if driving and len(driving) < len(seeds):
        which = "the one that drives" if len(driving) == 1 else f"the {len(driving)} that drive"
        rows.append((which, *_spreads(driving)))
    return rows


def _spreads(seeds: Sequence[UnsafeCounts]) -> list[str]:
    """Cells, total and completed twins over seeds; the counts themselves where there is one."""
    if len(seeds) == 1:
        return [*_cells(seeds[0]), str(seeds[0].unsafe), str(seeds[0].completed)]
    cells = {cell: Spread.of([counts.cells[cell] for counts in seeds]) for cell in CELLS}
    texts = (" · ".join(str(cells[kind, fault]) for fault in FAULTS) for kind in PAPER_TYPES)
    figures = ([one.unsafe for one in seeds], [one.completed for one in seeds])
    return [*texts, *(str(Spread.of(each)) for each in figures)]


def _cells(counts: UnsafeCounts) -> list[str]:
    return [" · ".join(str(counts.cells[kind, fault]) for fault in FAULTS) for kind in PAPER_TYPES]
