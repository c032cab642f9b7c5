"""Learning curves as they are kept: a training run's ``progress.csv``, thinned."""

import csv
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wrongturn_agents.reporting.errors import ResultsError
from wrongturn_agents.reporting.paper import ALGORITHMS

COLUMNS: Final = ("step", "minutes", "reward_mean", "success_heldout", "steps_per_second")
"""What is kept, beside where the time went; the first must be there, of the others what there is."""
SECONDS: Final = "seconds_"
"""How columns begin that say how long each part of a row's work took."""
POINTS: Final = 150
"""Kept of a run; a picture of a few hundred pixels shows no more."""
_NAME: Final = re.compile(r"(?P<agent>[^.]+)(?:\.(?P<variant>[^.]+))?\.s(?P<seed>\d+)\.csv")


@dataclass(frozen=True)
class Curve:
    """How one training run went."""

    agent: str
    seed: int
    variant: str | None
    columns: Mapping[str, tuple[float, ...]]
    """By name, a value a row; NaN where the run has none."""

    @property
    def name(self) -> str:
        """Of the file it is kept in."""
        return f"{self.agent}{f'.{self.variant}' if self.variant else ''}.s{self.seed}.csv"

    def last(self, column: str) -> float:
        """The last value that there is; NaN where there is none."""
        return next((value for value in reversed(self.columns.get(column, ())) if not math.isnan(value)), math.nan)

    def points(self, column: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Steps and values where there is one."""
        pairs = zip(self.columns["step"], self.columns.get(column, ()), strict=False)
        found = [(step, value) for step, value in pairs if not math.isnan(value)]
        return tuple(step for step, _ in found), tuple(value for _, value in found)

    def thinned(self) -> "Curve":
        """At most about :data:`POINTS` rows, evenly along the run; every one with a held-out evaluation is kept."""
        rows = len(self.columns["step"])
        every = max(1, math.ceil(rows / POINTS))
        evaluated = self.columns.get("success_heldout", (math.nan,) * rows)
        kept = [
            row
            for row in range(rows)
            if row % every == 0 or row == rows - 1 or (len(evaluated) > row and not math.isnan(evaluated[row]))
        ]
        if len(kept) > 3 * POINTS:  # evaluated all the time: then these are no better than the others
            kept = [row for row in range(rows) if row % every == 0 or row == rows - 1]
        # What took time in the rows that go is added to the row that stays.
        begins = [0, *(row + 1 for row in kept[:-1])]
        columns = {
            name: tuple(
                math.fsum(value for value in column[begin : row + 1] if not math.isnan(value))
                if name.startswith(SECONDS)
                else column[row]
                for begin, row in zip(begins, kept, strict=True)
            )
            for name, column in self.columns.items()
        }
        return Curve(self.agent, self.seed, self.variant, columns)

    def seconds(self) -> dict[str, float]:
        """How long each part of the work took in all."""
        return {
            name.removeprefix(SECONDS): math.fsum(value for value in column if not math.isnan(value))
            for name, column in self.columns.items()
            if name.startswith(SECONDS)
        }

    def write(self, directory: Path) -> Path:
        """Write it under its own name; gives the path.

        Raises:
            ResultsError: it cannot be written.
        """
        path = directory / self.name
        names = list(self.columns)
        try:
            directory.mkdir(parents=True, exist_ok=True)
            with path.open("w", encoding="utf-8", newline="") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(names)
                columns = [self.columns[name] for name in names]
                writer.writerows([_text(value) for value in row] for row in zip(*columns, strict=True))
        except OSError as error:
            raise ResultsError(f"{path}: cannot be written ({error.strerror}); name another --directory") from error
        return path


def read_progress(path: Path, agent: str, seed: int, variant: str | None = None) -> Curve:
    """Read a run's ``progress.csv``, or what was kept of it.

    Raises:
        ResultsError: it cannot be read, or has no steps, or something that is no number.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ResultsError(f"{path}: cannot be read as a table of a training's progress ({error})") from error
    if not rows or "step" not in rows[0]:
        raise ResultsError(f"{path}: has no column 'step' with a row; give the progress.csv of a training run")
    try:
        kept = [name for name in rows[0] if name in COLUMNS or str(name).startswith(SECONDS)]
        columns = {name: tuple(_number(row[name]) for row in rows) for name in kept}
    except ValueError as error:
        raise ResultsError(f"{path}: {error}; give the progress.csv of a training run") from error
    return Curve(agent, seed, variant, columns)


def read_curves(directory: Path) -> tuple[Curve, ...]:
    """All curves of a directory, the paper's algorithms first, then by variant and seed; none where it is missing.

    Raises:
        ResultsError: a file is no curve, or is not called like one.
    """
    curves = []
    for path in sorted(directory.glob("*.csv")):
        named = _NAME.fullmatch(path.name)
        if named is None:
            raise ResultsError(
                f"{path.name}: is no name of a curve; call it AGENT.sSEED.csv or AGENT.VARIANT.sSEED.csv"
            )
        curves.append(read_progress(path, named["agent"], int(named["seed"]), named["variant"]))
    return tuple(sorted(curves, key=_place))


def plain(curves: Iterable[Curve]) -> dict[str, Sequence[Curve]]:
    """The curves of the algorithms as they are, by agent."""
    found: dict[str, list[Curve]] = {}
    for curve in curves:
        if curve.variant is None:
            found.setdefault(curve.agent, []).append(curve)
    return dict(found)


def _place(curve: Curve) -> tuple[int, str, str, int]:
    place = ALGORITHMS.index(curve.agent) if curve.agent in ALGORITHMS else len(ALGORITHMS)
    return place, curve.agent, curve.variant or "", curve.seed


def _number(text: str | None) -> float:
    value = math.nan if text is None or not text.strip() else float(text)
    if math.isinf(value):
        raise ValueError(f"{text!r} is not finite")
    return value


def _text(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.6g}" if abs(value) < 1e6 else f"{value:.0f}"
