"""What an agent did in practice, as a table: how safe and able it was, and how its trials ended."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from rich.table import Table
from rich.text import Text

from wrongturn_agents.results_file import ResultsFile, TrialResult
from wrongturn_agents.suites import SuiteTrials
from wrongturn_client.tables import plain_table
from wrongturn_protocol import FaultKind, Trial, Verdict

_DONE: Final = {Verdict.EXIT_COMMANDED, Verdict.ARRIVED}
_TWIN: Final = "no fault (twin)"
_JOURNEY: Final = "journey"


@dataclass(frozen=True, order=True)
class _Kind:
    """Trials that share a row; rows are in the order of the fields."""

    faultless: bool
    fault: str
    of: str
    """Junction type, or the task of journeys."""

    @classmethod
    def of_trial(cls, trial: Trial) -> "_Kind":
        if trial.journey is not None:
            return cls(faultless=True, fault=_JOURNEY, of=trial.journey.task.value)
        fault = trial.fault.kind
        faultless = fault is FaultKind.NONE
        return cls(faultless, _TWIN if faultless else fault.value, trial.junction_type.value)


def practice_table(results: ResultsFile, suite: SuiteTrials) -> Table:
    """Return a row for each fault and junction type, or for each task of journeys, and the totals.

    Trials with a fault count as unsafe as in the strict column. Twins and journeys count as done.
    """
    kinds: dict[_Kind, list[TrialResult]] = {}
    for name, result in results.trials.items():
        kinds.setdefault(_Kind.of_trial(suite.trials[name]), []).append(result)
    table = plain_table(f"{results.agent} on {results.suite}: practice")
    for head in ("fault", "of"):
        table.add_column(head, no_wrap=True)
    for head in ("unsafe", "done"):
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("how they ended")
    for kind, found in sorted(kinds.items(), key=lambda item: item[0]):
        counts = ("-", _done(found)) if kind.faultless else (_unsafe(found), "-")
        table.add_row(*map(Text, (kind.fault, kind.of, *counts, _endings(found))))
    faulty = [one for kind, found in kinds.items() if not kind.faultless for one in found]
    others = [one for kind, found in kinds.items() if kind.faultless for one in found]
    totals = [f"{_unsafe(faulty)} trials unsafe (strict)"] * bool(faulty)
    totals += [f"{_done(others)} {'twins' if faulty else 'journeys'} done"] * bool(others)
    draw = "the suite's own trials" if suite.secret is None else "the open draw, which everybody knows"
    table.caption = Text(f"{'; '.join(totals)}\nPractice on {draw}. It is never scored.")
    return table


def _unsafe(found: Sequence[TrialResult]) -> str:
    return f"{sum(one.unsafe_strict for one in found)}/{len(found)}"


def _done(found: Sequence[TrialResult]) -> str:
    return f"{sum(one.verdict in _DONE for one in found)}/{len(found)}"


def _endings(found: Sequence[TrialResult]) -> str:
    """Return how often each verdict was given, the most frequent first."""
    counts = Counter(one.verdict.value for one in found)
    return ", ".join(f"{verdict} {count}" for verdict, count in counts.most_common())
