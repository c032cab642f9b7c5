"""How the trials of trained agents ended: the table of ``docs/results.md``, and the one beside the paper's words."""

from collections import Counter
from collections.abc import Container, Sequence
from statistics import median
from typing import Final

from lab.stored_results import Collection
from lab.tables import FAULTS, Row, Table, count_unsafe, label, label_first
from wrongturn_agents.results_file import ResultsFile, TrialResult
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_protocol import PAPER, PAPER_TYPES, FaultKind, JunctionType, Reaction
from wrongturn_protocol.words import name

_COMPARED: Final = (JunctionType.STRAIGHT_RIGHT, JunctionType.LEFT_RIGHT)
"""Types at which agents differ. At STRAIGHT_LEFT nearly all take an exit, in the paper and here."""


def _of_seeds_that_drive(collection: Collection, agent: str) -> list[ResultsFile]:
    by_seed = collection.by_seed(WRONG_COMMAND, agent).items()
    return [file for seed, file in by_seed if seed is not None and count_unsafe(file).drives]


def _found(files: Sequence[ResultsFile], fault: FaultKind, kinds: Container[JunctionType]) -> list[TrialResult]:
    """Return what came of all trials with a fault at junctions of some types."""
    drawn = ((file.drawn.trials[name], one) for file in files for name, one in file.trials.items())
    return [one for trial, one in drawn if trial.fault.kind is fault and trial.junction_type in kinds]


def _ends(found: Sequence[TrialResult]) -> str:
    return _percent(Counter("exit" if one.verdict.exited else name(one.verdict) for one in found), len(found))


def _reactions(found: Sequence[TrialResult]) -> str:
    reactions = Counter(str(one.reaction) for one in found if one.reaction not in {None, Reaction.EXIT})
    return _percent(reactions, len(found))


def _percent(counts: Counter[str], of: int) -> str:
    return ", ".join(f"{name} {100 * count / of:.0f}" for name, count in counts.most_common())


def endings_table(collection: Collection) -> Table:
    """Return how a trained agent's trials with a fault ended, and how it reacted, in percent."""
    rows: list[Row] = []
    for agent in collection.agents(WRONG_COMMAND):
        files = _of_seeds_that_drive(collection, agent)
        own: list[Row] = []
        for fault in FAULTS if files else ():
            found = _found(files, fault, PAPER_TYPES)
            speeds = [one.speed_at_verdict for one in found if one.speed_at_verdict is not None]
            speed = f"{median(speeds):.1f}" if speeds else "–"
            own.append((name(fault), str(len(found)), _ends(found), _reactions(found), speed))
        rows += label_first(label(agent), own)
    note = (
        "Percent of the trials of all seeds that drive. With an omission, taking an exit is a reaction too, and "
        "is left out. The speed is the median at the verdict of unsafe trials, m/s."
    )
    head = ("agent", "fault", "trials", "how they ended", "how the agent reacted", "speed")
    return Table("How trials under a wrong command ended", head, rows, note if rows else "", words=5)


def paper_endings_table(collection: Collection) -> Table:
    """Return how trials ended at the two types where agents differ, beside the paper's unsafe counts."""
    rows: list[Row] = []
    for agent in PAPER:
        files = _of_seeds_that_drive(collection, agent.ours)
        own: list[Row] = []
        for kind in _COMPARED if files else ():
            wrong, none = (_found(files, fault, {kind}) for fault in FAULTS)
            theirs = (str(cells[PAPER_TYPES.index(kind)]) for cells in (agent.infeasible, agent.omission))
            own.append((name(kind), next(theirs), _ends(wrong), _reactions(wrong), next(theirs), _ends(none)))
        rows += label_first(label(agent.ours), own)
    note = "Ours: percent of the trials of all seeds that drive. The paper: unsafe trials of 10."
    head = ("agent", "junction", "infeasible: the paper", "ours", "reactions", "omission: the paper", "ours")
    return Table("How trials ended, beside the paper", head, rows, note if rows else "", words=7)
