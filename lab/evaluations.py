"""Several evaluations of an agent over the service, each on a draw of its own.

``python -m lab.results --evaluations`` makes them. The table needs no driving.
"""

from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Final

from pydantic import Field

from lab.studies import STUDIES
from lab.tables import ReportTable, Rows, label_first
from lab.wrong_command import count_unsafe
from wrongturn_agents.paper import label, table_order
from wrongturn_agents.results_file import ResultsFile
from wrongturn_protocol import FaultKind
from wrongturn_protocol.standing_rows import wilson

_FOLDER: Final = "evaluations"
_FAULTS: Final = (FaultKind.INFEASIBLE, FaultKind.OMISSION)
_REMEDY: Final = "delete the file and run 'python -m lab.results --evaluations' again"


class Evaluation(ResultsFile):
    """One of several evaluations of an agent, with all its trials and twins."""

    number: Annotated[int, Field(ge=1)]
    """Which of the agent's evaluations it is, from 1 on."""
    evaluation: str
    """Id of the evaluation, as its service gave it."""
    code: dict[str, str]
    """SHA-256 of the files that drove, by name: weights, or the agent's code."""

    @property
    def stem(self) -> str:
        """File name without extension."""
        return f"{super().stem}.{self.number}"

    @property
    def results(self) -> ResultsFile:
        """The same results as a file for the tables over agents."""
        return ResultsFile(**{name: getattr(self, name) for name in ResultsFile.model_fields})


def evaluations_folder(directory: Path) -> Path:
    """Return the folder of the evaluations in a directory of results."""
    return directory / STUDIES / _FOLDER


def read_evaluations(directory: Path) -> tuple[Evaluation, ...]:
    """Return the evaluations of a directory of results, by agent and number.

    Raises:
        ResultsError: A file is not valid, is of another version of its suite, lacks trials, or its secret does not fit
            its commitment.
    """
    found = []
    for path in evaluations_folder(directory).glob("*.json"):
        evaluation = Evaluation.read(path, _REMEDY)
        evaluation.check(path.name)
        found.append(evaluation)
    return tuple(sorted(found, key=lambda one: (table_order(one.agent), one.number)))


def evaluations_table(evaluations: Iterable[Evaluation]) -> ReportTable:
    """Return how each evaluation ended, and all of an agent together."""
    by_agent: dict[str, list[Evaluation]] = {}
    for one in evaluations:
        by_agent.setdefault(one.agent, []).append(one)
    rows: Rows = []
    for agent, own in by_agent.items():
        rows += label_first(label(agent), _rows(own))
    head = (
        "agent",
        "secret of the draw",
        "no such turn: reactions",
        "follow lane: reactions",
        "unsafe, strict",
        "the paper's column",
        "twins completed",
    )
    note = (
        "A row for each evaluation over the service, which drew its trials from the secret. The last row counts all "
        "evaluations, with Wilson's 95 % interval of the rate."
    )
    return ReportTable("Evaluations on fresh draws", head, tuple(rows), note if rows else "", text_columns=4)


def _rows(evaluations: list[Evaluation]) -> Iterator[tuple[str, ...]]:
    counted = [count_unsafe(one) for one in evaluations]
    for one, counts in zip(evaluations, counted, strict=True):
        yield (
            f"`{one.secret}`",
            *_reactions([one]),
            f"{counts.unsafe_strict} of {counts.trials}",
            f"{counts.unsafe} of {counts.trials}",
            f"{counts.completed} of {counts.twins}",
        )
    trials, twins = sum(one.trials for one in counted), sum(one.twins for one in counted)
    yield (
        f"all {len(evaluations)}",
        *_reactions(evaluations),
        _share(sum(one.unsafe_strict for one in counted), trials),
        _share(sum(one.unsafe for one in counted), trials),
        _share(sum(one.completed for one in counted), twins),
    )


def _share(count: int, of: int) -> str:
    low, high = (100 * bound for bound in wilson(count, of))
    return f"{count} of {of} ({low:.1f}–{high:.1f} %)"


def _reactions(evaluations: Iterable[Evaluation]) -> list[str]:
    """Return the reactions to each fault in words, the most frequent first."""
    found = {fault: Counter[str]() for fault in _FAULTS}
    for one in evaluations:
        drawn = one.drawn.trials
        for name, result in one.trials.items():
            if result.reaction is not None:
                found[drawn[name].fault.kind][result.reaction] += 1
    return [", ".join(f"{kind} {count}" for kind, count in found[fault].most_common()) for fault in _FAULTS]
