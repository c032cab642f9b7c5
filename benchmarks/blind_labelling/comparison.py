"""Compares the labels with what the judge says of the same drives."""

import json
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

from drives import Drive
from labels import Label, strict_column

from wrongturn_judge import JudgeGeometry, judge
from wrongturn_networks import town_of


@dataclass(frozen=True)
class Judged:
    """What the judge says of one drive, in a label's words."""

    verdict: str
    strict: str
    time: float
    """Time of the verdict, seconds."""


@dataclass(frozen=True)
class Pair:
    """A label, and what the judge says."""

    number: int
    drive: Drive
    label: Label
    judged: Judged

    @property
    def agrees(self) -> bool:
        """Whether verdict, exit and strict column are the same."""
        return (self.label.verdict, self.label.strict) == (self.judged.verdict, self.judged.strict)


def judged(drive: Drive) -> Judged:
    """Return what the judge says of a drive, which goes on past the verdict."""
    geometry = JudgeGeometry.of(town_of(drive.trial), drive.trial)
    outcome = judge(drive.trajectory, geometry)
    word = str(outcome.verdict)
    if outcome.verdict.exited:
        assert outcome.exit is not None
        word = f"exit_{outcome.exit.name.lower()}"
    return Judged(word, strict_column(outcome.verdict, opposed=outcome.unsafe_strict), outcome.time)


def compare(drives: list[Drive], labels: dict[int, Label]) -> list[Pair]:
    """Return a pair for each drive.

    Raises:
        ValueError: a drive has no label.
    """
    missing = [number for number in range(len(drives)) if number not in labels]
    if missing:
        raise ValueError(f"labels: {missing} have none; label them before you compare")
    return [Pair(number, drive, labels[number], judged(drive)) for number, drive in enumerate(drives)]


def table(pairs: list[Pair]) -> str:
    """Return the comparison in Markdown: agreement by label, and every disagreement."""
    lines = ["| label | clear | agree | not clear | agree |", "|---|---|---|---|---|"]
    words = Counter(pair.label.verdict for pair in pairs)
    for word in [*sorted(words), "all"]:
        counts = []
        for clear in (True, False):
            some = [pair for pair in pairs if word in {pair.label.verdict, "all"} and pair.label.clear is clear]
            counts += [len(some), sum(pair.agrees for pair in some)]
        name = word if word == "all" else f"`{word}`"
        lines.append(f"| {name} | {' | '.join(map(str, counts))} |")
    different = [pair for pair in pairs if not pair.agrees]
    if different:
        lines += ["", "| picture | driver | label | judge | clear |", "|---|---|---|---|---|"]
    for pair in different:
        said, found = (f"`{one.verdict}`, {one.strict}" for one in (pair.label, pair.judged))
        clear = "yes" if pair.label.clear else "no"
        lines.append(f"| {pair.number:03d} | {pair.drive.driver} | {said} | {found}, {pair.judged.time} s | {clear} |")
    return "\n".join(lines)


def write(pairs: list[Pair], file: Path) -> None:
    """Keep what the judge says, a line each."""
    lines = [f' "{pair.number:03d}": {json.dumps(asdict(pair.judged))}' for pair in pairs]
    file.write_text("{\n" + ",\n".join(lines) + "\n}\n", "utf-8")


def read(file: Path) -> dict[int, Judged]:
    """Return what the judge said, by number."""
    return {int(number): Judged(**fields) for number, fields in json.loads(file.read_text("utf-8")).items()}
