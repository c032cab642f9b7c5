r"""The paper's table II with our agents: LaTeX for ``\usepackage{booktabs}``, or for the terminal."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Final

from wrongturn_agents.records.evaluation_record import Drive, EvaluationRecord, checked
from wrongturn_protocol import PAPER, JunctionType, Metrics, StrictUnsafeCount, TableCell, TwinCount, UnsafeCount
from wrongturn_protocol.intervals import interval, marks_of
from wrongturn_protocol.standing_rows import INTERVALS, NONE, TRAINED, Columns, StandingRow
from wrongturn_protocol.words import name

if TYPE_CHECKING:
    from rich.table import Table

_SPECIAL: Final = str.maketrans(
    {
        **{sign: f"\\{sign}" for sign in "&%$#_{}"},
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        NONE: "--",
        TRAINED: r"\dag",
    }
)


def escaped(text: str) -> str:
    """Return text as LaTeX shows it."""
    return text.translate(_SPECIAL).replace(r" \dag", r"\,\dag")


def results_table(runs: Sequence[EvaluationRecord], *, paper: bool = False) -> "Table":
    """Return the table of :func:`latex_table` for the terminal."""
    from wrongturn_client.tables import standings_table  # noqa: PLC0415 - rich is slow to import

    columns, rows = _rows(runs, paper=paper)
    return standings_table(f"{runs[0].suite}: {columns.title}", columns, [([label], row) for label, row in rows])


def latex_table(runs: Sequence[EvaluationRecord], *, paper: bool = False) -> str:
    """Return the paper's table II with our rows: unsafe trials by junction type and fault, a line for each fault.

    Cells and ``Strict`` count in the column that ranks, with the 95 % interval of its rate. The last line says what the
    interval speaks of.

    Args:
        runs: One run of each agent, all on one suite with twins.
        paper: Put the paper's agents first. They have the paper's column only.

    Raises:
        ResultsError: There is no run, the runs are of several suites, or the suite has no twins.
    """
    columns, rows = _rows(runs, paper=paper)
    shown = [column for column in columns.figures if not column.extra]
    heads = ["Agent", columns.line, *map(name, columns.parts), shown[0].name, "95 %", *(one.name for one in shown[1:])]
    body = "\\addlinespace\n".join(_block(label, columns, row, len(shown)) for label, row in rows)
    return (
        f"\\begin{{tabular}}{{ll{'r' * (len(heads) - 2)}}}\n\\toprule\n{_line(heads)}\\midrule\n{body}"
        "\\bottomrule\n"
        f"\\multicolumn{{{len(heads)}}}{{p{{.95\\linewidth}}}}{{\\footnotesize {INTERVALS}}} \\\\\n"
        "\\end{tabular}\n"
    )


def _rows(runs: Sequence[EvaluationRecord], *, paper: bool) -> tuple[Columns, list[tuple[str, StandingRow]]]:
    metrics = {run.label: metrics_of(run) for run in checked(runs)}
    columns = Columns.of(metrics.values())
    theirs = [(agent.title, columns.row_of_paper(agent)) for agent in PAPER if paper]
    return columns, [*theirs, *((label, columns.row(found)) for label, found in metrics.items())]


def metrics_of(run: EvaluationRecord) -> Metrics:
    """Return the counts of a run, as a leaderboard has them.

    Raises:
        ResultsError: The suite has no twins.
    """
    strict: dict[JunctionType, dict[str, list[Drive]]] = {}
    for drive, _ in run.pairs():
        strict.setdefault(drive.trial.junction_type, {}).setdefault(drive.trial.fault.kind, []).append(drive)
    tables = (
        {kind: {fault: _cell(drives, column) for fault, drives in row.items()} for kind, row in strict.items()}
        for column in ("unsafe", "unsafe_strict")
    )
    return Metrics(
        unsafe=UnsafeCount.model_validate(_counted(run.trials, "unsafe")),
        unsafe_strict=StrictUnsafeCount.model_validate(_counted(run.trials, "unsafe_strict")),
        twins=TwinCount(
            unsafe=sum(twin.result.unsafe for twin in run.twins),
            completed=sum(twin.result.completed for twin in run.twins),
            trials=len(run.twins),
        ),
        excess_unsafe_rate=None,
        table=next(tables),
        table_strict=next(tables),
        reactions={},
        verdicts={},
    )


def _cell(drives: Sequence[Drive], column: str) -> TableCell:
    return TableCell(unsafe=sum(getattr(drive.result, column) for drive in drives), trials=len(drives))


def _counted(drives: Sequence[Drive], column: str) -> dict[str, object]:
    cell = _cell(drives, column)
    ends = interval(marks_of((drive.trial, getattr(drive.result, column)) for drive in drives))
    return {"count": cell.unsafe, "trials": cell.trials, "rate": cell.unsafe / cell.trials, "ci95": ends}


def _block(label: str, columns: Columns, row: StandingRow, shown: int) -> str:
    """Return an agent's lines; the first has its name and its figures, and the interval that one of these has."""
    first, *others = row.figures[:shown]
    ends = [first.main, next(one.interval for one in row.figures if one.interval), *(one.main for one in others)]
    lines = zip(columns.lines, row.parts, strict=True)
    return "".join(
        _line(["" if number else label, name(line), *parts, *([""] * len(ends) if number else ends)])
        for number, (line, parts) in enumerate(lines)
    )


def _line(texts: Iterable[str]) -> str:
    return " & ".join(map(escaped, texts)) + " \\\\\n"
