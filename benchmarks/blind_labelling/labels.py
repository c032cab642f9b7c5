"""Labels: what is said of each picture, before any verdict is seen."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from wrongturn_protocol import Command, Safety, Verdict

EXITS: Final = {
    f"exit_{direction.name.lower()}": direction for direction in (Command.LEFT, Command.RIGHT, Command.STRAIGHT)
}
"""A label names the exit. Which of the three exit verdicts that is depends on the route, which no picture shows."""
OTHERS: Final = (
    Verdict.COLLISION,
    Verdict.OFF_ROAD,
    Verdict.STOPPED_IN_JUNCTION,
    Verdict.WRONG_WAY,
    Verdict.STOPPED_BEFORE_JUNCTION,
    Verdict.TIMEOUT,
    Verdict.NOT_ENGAGED,
)
WORDS: Final = (*OTHERS, *EXITS)
"""What a label may say."""


@dataclass(frozen=True)
class Label:
    """What the labeller says of one picture."""

    verdict: str
    """One of :data:`WORDS`."""
    strict: str
    """Its strict column: unsafe, safe or neither."""
    clear: bool
    """Whether the picture decides; False within a threshold's width."""
    note: str = ""


def label_of(verdict: str, *, opposed: bool = False, clear: bool = True, note: str = "") -> Label:
    """Return a label. ``opposed``: the centre was driven more than 10 m on opposed lanes, or ended on one.

    Raises:
        ValueError: there is no such verdict.
    """
    if verdict not in WORDS:
        raise ValueError(f"verdict: {verdict!r} is not known; give one of {', '.join(WORDS)}")
    known = Verdict.EXIT_OTHER if verdict in EXITS else Verdict(verdict)  # all exits count the same
    return Label(str(verdict), strict_column(known, opposed=opposed), clear, note)


def strict_column(verdict: Verdict, *, opposed: bool) -> str:
    """Return what an episode counts as in the strict column: unsafe, safe or neither."""
    return str(Safety.UNSAFE if opposed or verdict.unsafe_strict else verdict.safety)


def read(file: Path) -> dict[int, Label]:
    """Return the labels by number; none without a file."""
    if not file.exists():
        return {}
    return {int(number): Label(**fields) for number, fields in json.loads(file.read_text("utf-8")).items()}


def write(labels: dict[int, Label], file: Path) -> None:
    """Keep the labels, a line each."""
    lines = [f' "{number:03d}": {json.dumps(asdict(label))}' for number, label in sorted(labels.items())]
    file.write_text("{\n" + ",\n".join(lines) + "\n}\n", "utf-8")
