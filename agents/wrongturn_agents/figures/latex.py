r"""The reference paper's table II with our agents: LaTeX for ``\usepackage{booktabs}``, or for the terminal."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from wrongturn_agents.figures.drives import Drives, checked
from wrongturn_agents.paper import TRAINED_ON_FAULTS
from wrongturn_agents.statistics import wilson
from wrongturn_client.plain_table import plain_table
from wrongturn_protocol import PAPER, PAPER_TYPES, FaultKind, JunctionType, PaperAgent, Verdict

if TYPE_CHECKING:
    from rich.table import Table

_COMMANDS: Final = {FaultKind.INFEASIBLE: "wrong", FaultKind.OMISSION: "follow lane"}
_TOTALS: Final = ("unsafe", "95 % CI", "paper's", "twins completed")
_SPECIAL: Final = str.maketrans(
    {
        **{sign: f"\\{sign}" for sign in "&$#_{}"},
        "%": r"\%",
        "–": "--",
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
    }
)
_Cells = Mapping[tuple[JunctionType, FaultKind], str]


def escaped(text: str) -> str:
    """Return text as LaTeX shows it."""
    return text.translate(_SPECIAL).replace(f" {TRAINED_ON_FAULTS}", r"\,\dag").replace(r" \%", r"\,\%")


def latex_table(runs: Sequence[Drives], *, paper: bool = False) -> str:
    """Return the table of :func:`unsafe_table` in LaTeX.

    Raises:
        ResultsError: There is no run, the runs are of several suites, or the suite has no twins.
        MissingPackageError: scipy is not installed.
    """
    table = unsafe_table(runs, paper=paper)
    blocks = ["".join(" & ".join(map(escaped, row)) + " \\\\\n" for row in block) for block in table.blocks]
    return (
        f"\\begin{{tabular}}{{ll{'r' * (len(table.head) - 2)}}}\n"
        "\\toprule\n"
        f"{' & '.join(map(escaped, table.head))} \\\\\n"
        "\\midrule\n" + "\\addlinespace\n".join(blocks) + "\\bottomrule\n"
        "\\end{tabular}\n"
    )


@dataclass(frozen=True)
class UnsafeTable:
    """Unsafe trials by agent, command and junction type."""

    head: tuple[str, ...]
    blocks: tuple[tuple[tuple[str, ...], ...], ...]
    """Rows of each agent, one for each fault. The first has its name and totals."""

    def rich(self, title: str) -> "Table":
        """Return the table for the terminal."""
        table = plain_table(title)
        for number, name in enumerate(self.head):
            table.add_column(name, justify="left" if number < 2 else "right")
        for block in self.blocks:
            for number, row in enumerate(block, 1):
                table.add_row(*row, end_section=number == len(block))
        return table


def unsafe_table(runs: Sequence[Drives], *, paper: bool = False) -> UnsafeTable:
    """Return the paper's table II with our rows.

    Cells and ``unsafe`` count in the strict column, which ranks; the interval is Wilson's of its rate, and ``paper's``
    counts in the paper's column.

    Args:
        runs: One run of each agent, all on one suite with twins.
        paper: Put the paper's agents first. They have the paper's column only.

    Raises:
        ResultsError: There is no run, the runs are of several suites, or the suite has no twins.
        MissingPackageError: scipy is not installed.
    """
    cells = {run.agent: _cells(run) for run in checked(runs)}
    faults = [fault for fault in FaultKind if any(fault is kind for found in cells.values() for _, kind in found)]
    driven = {kind for found in cells.values() for kind, _ in found}
    types = [*PAPER_TYPES, *(kind for kind in JunctionType if kind in driven and kind not in PAPER_TYPES)]
    blocks = [_block(run.label, cells[run.agent], _totals(run), types, faults) for run in runs]
    if paper:
        theirs = [_block(one.title, _cells_of_paper(one), _totals_of_paper(one), types) for one in PAPER]
        blocks = [*theirs, *blocks]
    return UnsafeTable(("agent", "command", *(kind.value for kind in types), *_TOTALS), tuple(blocks))


def _block(
    name: str,
    cells: _Cells,
    totals: tuple[str, ...],
    types: Sequence[JunctionType],
    faults: Sequence[FaultKind] = tuple(_COMMANDS),
) -> tuple[tuple[str, ...], ...]:
    rows = []
    for number, fault in enumerate(faults):
        shown = [cells.get((kind, fault), "–") for kind in types]
        rows.append(
            ("" if number else name, _COMMANDS.get(fault, fault.value), *shown, *([""] * 4 if number else totals))
        )
    return tuple(rows)


def _cells(run: Drives) -> _Cells:
    """Return unsafe trials of all, in the strict column, by junction type and fault."""
    unsafe: dict[tuple[JunctionType, FaultKind], list[bool]] = {}
    for drive, _ in run.pairs():
        unsafe.setdefault((drive.trial.junction_type, drive.trial.fault.kind), []).append(drive.result.unsafe_strict)
    return {cell: f"{sum(found)}/{len(found)}" for cell, found in unsafe.items()}


def _totals(run: Drives) -> tuple[str, ...]:
    strict = sum(drive.result.unsafe_strict for drive in run.trials)
    paper = sum(drive.result.unsafe for drive in run.trials)
    done = sum(twin.result.verdict is Verdict.EXIT_COMMANDED for twin in run.twins)
    trials = len(run.trials)
    return f"{strict}/{trials}", _interval(strict, trials), f"{paper}/{trials}", f"{done}/{len(run.twins)}"


def _cells_of_paper(agent: PaperAgent) -> _Cells:
    counts = {FaultKind.INFEASIBLE: agent.infeasible, FaultKind.OMISSION: agent.omission}
    return {
        (kind, fault): f"{count}/10"
        for fault, found in counts.items()
        for kind, count in zip(PAPER_TYPES, found, strict=True)
    }


def _totals_of_paper(agent: PaperAgent) -> tuple[str, ...]:
    return "–", _interval(agent.unsafe, 60), f"{agent.unsafe}/60", "–"


def _interval(count: int, trials: int) -> str:
    low, high = wilson(count, trials)
    return f"{100 * low:.0f}–{100 * high:.0f}"
