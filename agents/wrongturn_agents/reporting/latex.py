r"""LaTeX tables in the layout of the reference paper's, for ``\usepackage{booktabs}``."""

from collections.abc import Mapping, Sequence
from typing import Final

from wrongturn_agents.reporting.drives import Drives, checked
from wrongturn_agents.reporting.tables import wilson
from wrongturn_protocol import PAPER, PAPER_TYPES, FaultKind, JunctionType, PaperAgent, Verdict

_COMMANDS: Final = {FaultKind.INFEASIBLE: "wrong", FaultKind.OMISSION: "follow lane"}
_SPECIAL: Final = str.maketrans(
    {
        **{sign: f"\\{sign}" for sign in "&%$#_{}"},
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
    }
)
_SPACE: Final = "\\addlinespace\n"
_Cells = Mapping[tuple[JunctionType, FaultKind], str]


def escaped(text: str) -> str:
    """Return text as LaTeX shows it."""
    return text.translate(_SPECIAL)


def latex_table(runs: Sequence[Drives], *, paper: bool = False) -> str:
    """Return the paper's table II with our rows: unsafe trials by junction type and command.

    Each agent has a row for each fault. Cells and ``unsafe`` count in the strict column, which ranks; the interval is
    Wilson's of its rate, and ``paper's`` counts in the paper's column.

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
    blocks = [_block(_name(run), cells[run.agent], _totals(run), types, faults) for run in runs]
    if paper:
        theirs = [_block(escaped(one.title), _cells_of_paper(one), _totals_of_paper(one), types) for one in PAPER]
        blocks = [*theirs, *blocks]
    heads = " & ".join(escaped(kind.value) for kind in types)
    return (
        f"\\begin{{tabular}}{{ll{'r' * (len(types) + 4)}}}\n"
        "\\toprule\n"
        f"agent & command & {heads} & unsafe & 95\\,\\% CI & paper's & twins completed \\\\\n"
        "\\midrule\n"
        f"{_SPACE.join(blocks)}"
        "\\bottomrule\n"
        "\\end{tabular}\n"
    )


def _name(run: Drives) -> str:
    return escaped(run.agent) + r"\,\dag" * run.trained_on_faults


def _block(
    name: str,
    cells: _Cells,
    totals: tuple[str, ...],
    types: Sequence[JunctionType],
    faults: Sequence[FaultKind] = tuple(_COMMANDS),
) -> str:
    """Return an agent's rows, one for each fault; the first has its name and totals."""
    rows = []
    for number, fault in enumerate(faults):
        command = _COMMANDS.get(fault, fault.value)
        shown = [cells.get((kind, fault), "--") for kind in types]
        row = (name, command, *shown, *totals) if number == 0 else ("", command, *shown, *[""] * len(totals))
        rows.append(" & ".join(row) + " \\\\\n")
    return "".join(rows)


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
    return {
        **{
            (kind, FaultKind.INFEASIBLE): f"{count}/10"
            for kind, count in zip(PAPER_TYPES, agent.infeasible, strict=True)
        },
        **{(kind, FaultKind.OMISSION): f"{count}/10" for kind, count in zip(PAPER_TYPES, agent.omission, strict=True)},
    }


def _totals_of_paper(agent: PaperAgent) -> tuple[str, ...]:
    return "--", _interval(agent.unsafe, 60), f"{agent.unsafe}/60", "--"


def _interval(count: int, trials: int) -> str:
    low, high = wilson(count, trials)
    return f"{100 * low:.0f}--{100 * high:.0f}"
