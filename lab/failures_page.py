"""The sections of ``docs/failures.md``: how often each agent fails where, and each way with its film."""

import os
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from lab.failure_words import (
    collision_shown,
    collisions_in_words,
    explanation,
    heading,
    shown,
)
from lab.failures import (
    FILMS,
    Ended,
    Failures,
    Film,
    FilmedAgent,
    results_of,
)
from lab.tables import ReportTable
from lab.weights import learned_agents
from wrongturn_agents.stored_results import Collection
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_protocol import PAPER_TYPES, FaultKind, Verdict

_FAULTS: Final = (FaultKind.INFEASIBLE, FaultKind.OMISSION)
_JOURNEYS: Final = {
    Verdict.ARRIVED: "arrived",
    Verdict.COLLISION: "ended in a collision",
    Verdict.TIMEOUT: "ran out of time",
}
_INSTEAD: Final = " Here is what it does where other agents fail."


def counts_table(collection: Collection, study: Failures | None) -> ReportTable:
    """Return how many trials of each agent are unsafe, by junction type and fault."""
    rows = []
    for agent in learned_agents():
        ended = results_of(collection, agent, None if study is None else study.agents.get(agent))
        if ended is not None:
            rows.append((f"`{agent}`", _draw(ended), *_counts(ended)))
    head = ("agent", "draw", *(str(kind) for kind in PAPER_TYPES), "unsafe")
    note = "Unsafe trials, strict column: with a wrong command · without a command. Ten trials each, 60 in all."
    return ReportTable("Failures", head, tuple(rows), note)


def _draw(ended: Ended) -> str:
    """Return which draw the trials are of: the open one, or that of an evaluation over the service."""
    return "open" if ended.secret == WRONG_COMMAND else "of its evaluation over the service"


def _counts(ended: Ended) -> tuple[str, ...]:
    counts = Counter({way.cell: 0 for way in ended.ways()})
    for way, names in ended.unsafe_ways().items():
        counts[way.cell] += len(names)
    cells = (" · ".join(str(counts[kind, fault]) for fault in _FAULTS) for kind in PAPER_TYPES)
    return (*cells, str(counts.total()))


def ways_text(collection: Collection, study: Failures | None, page: Path) -> str:
    """Return each agent's ways, with their films and what was measured, for a page at this path."""
    parts: list[str] = []
    for agent in learned_agents():
        parts.append(f"## {agent}\n")
        filmed = None if study is None else study.agents.get(agent)
        ended = results_of(collection, agent, filmed)
        if filmed is None or ended is None:
            parts.append("*Not filmed yet.*\n")
            continue
        unsafe = sum(map(len, ended.unsafe_ways().values()))
        faulted = sum(map(len, ended.ways().values()))
        parts.append(f"{unsafe} of {faulted} trials are unsafe." + (_INSTEAD if not unsafe else "") + "\n")
        parts += _ways(agent, filmed, ended, page)
    return "\n".join(parts)


def _ways(agent: str, filmed: FilmedAgent, ended: Ended, page: Path) -> Iterable[str]:
    for one in filmed.ways:
        of_cell = sum(len(names) for way, names in ended.ways().items() if way.cell == one.way.cell)
        yield f"### {heading(one.way)}\n"
        if one.film is not None:
            yield _image(shown(agent, one, one.film), one.film, page)
        again = "" if len(one.drives) == len(one.trials) else f" Driven again, {len(one.drives)} of them ended so."
        yield f"**{len(one.trials)} of {of_cell}.**{again} {explanation(one)}\n"


def collisions_text(study: Failures | None, page: Path) -> str:
    """Return how each agent's journeys beside traffic ended, and how its collisions happened."""
    parts: list[str] = []
    for agent in learned_agents():
        filmed = None if study is None else study.agents.get(agent)
        if filmed is None or not filmed.journeys:
            continue
        contacts = [one.contact for one in filmed.journeys if one.contact is not None]
        ends = Counter(_JOURNEYS.get(one.verdict, "ended otherwise") for one in filmed.journeys)
        said = ", ".join(f"{count} {end}" for end, count in ends.most_common())
        line = f"**`{agent}`**, {len(filmed.journeys)} journeys: {said}. {collisions_in_words(contacts)}"
        parts.append(line.strip() + "\n")
        parts += [
            _image(collision_shown(agent, one.contact), one.film, page)
            for one in filmed.journeys
            if one.film is not None and one.contact is not None
        ]
    return "\n".join(parts) or "*No journey is filmed yet.*\n"


def _image(text: str, film: Film, page: Path) -> str:
    return f"![{text}]({os.path.relpath(FILMS / film.file, page.parent)})\n"
