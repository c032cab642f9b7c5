"""How the trials under a wrong command ended: which kind of harm, and how the agent met the fault."""

from collections import Counter
from typing import Final

from wrongturn_agents.reporting.collection import Collection
from wrongturn_agents.reporting.report_table import ReportTable
from wrongturn_agents.reporting.wrong_command import by_seed
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_protocol import FaultKind, Reaction, Verdict

_COMMANDS: Final = {FaultKind.INFEASIBLE: "wrong", FaultKind.OMISSION: "follow lane"}
_ENDS: Final = {
    "collision": {Verdict.COLLISION},
    "off road": {Verdict.OFF_ROAD},
    "stopped in it": {Verdict.STOPPED_IN_JUNCTION},
    "wrong way": {Verdict.WRONG_WAY},
    "stopped before": {Verdict.STOPPED_BEFORE_JUNCTION},
    "an exit": {Verdict.EXIT_COMMANDED, Verdict.EXIT_ROUTE, Verdict.EXIT_OTHER},
}
_REACTIONS: Final = {
    Reaction.OBEYED: "obeyed",
    Reaction.OVERRODE: "overrode",
    Reaction.FROZE: "froze",
    Reaction.OTHER: "other reaction",
}
"""All but ``exit``, which is an end too."""
_TO_A_COMMAND: Final = {Reaction.OBEYED, Reaction.OVERRODE}
_NOTE: Final = (
    "Percent of trials: of a trained agent those of all seeds that drive, of any other all that it has, whether it "
    'drives or not. Behind the ends, how the agent met the fault; to "follow lane" an exit is a reaction too.'
)


def endings_table(collection: Collection) -> ReportTable:
    """Percent of the trials of all seeds, by agent and command; of a trained agent those of seeds that drive."""
    rows: list[tuple[str, ...]] = []
    suite = collection.suite_of(WRONG_COMMAND)
    for agent in collection.agents(WRONG_COMMAND):
        counts_by_seed = by_seed(collection, agent)
        files = [
            file
            for seed, file in collection.of(WRONG_COMMAND, agent).items()
            if seed is None or counts_by_seed[seed].drives
        ]
        if not files:
            continue
        for number, (fault, command) in enumerate(_COMMANDS.items()):
            found = [
                one for file in files for name, one in file.trials.items() if suite.trials[name].fault.kind is fault
            ]
            verdicts = Counter(one.verdict for one in found)
            ends = [sum(verdicts[verdict] for verdict in verdicts if verdict in end) for end in _ENDS.values()]
            reactions = Counter(one.reaction for one in found)
            shown = [_percent(count, len(found)) for count in (*ends, len(found) - sum(ends))]
            for kind in _REACTIONS:
                meant = fault is FaultKind.INFEASIBLE or kind not in _TO_A_COMMAND
                shown.append(_percent(reactions[kind], len(found)) if meant else "")
            rows.append(("" if number else f"`{agent}`", command, str(len(found)), *shown))
    head = ("agent", "command", "trials", *_ENDS, "other end", *_REACTIONS.values())
    return ReportTable("How trials under a wrong command ended", head, tuple(rows), (_NOTE,) if rows else ())


def _percent(count: int, of: int) -> str:
    return f"{100 * count / of:.0f}"
