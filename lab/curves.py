"""Learning curves: a training run's ``progress.csv``, thinned for storage; and their tables."""

import csv
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Final

from lab.tables import ReportTable, Rows, label_first
from wrongturn_agents.errors import ResultsError
from wrongturn_agents.paper import table_order

POINTS: Final = 150
"""Number of rows kept of a run; a picture of a few hundred pixels shows no more."""
REWARD: Final = "reward_mean"
"""Column that runs of reinforcement learning have."""
LOSS: Final = "loss"
"""Column that runs of imitation have."""
HELD_OUT: Final = "success_heldout"
_COLUMNS: Final = ("step", "minutes", REWARD, LOSS, HELD_OUT, "traffic_success_heldout", "steps_per_second")
"""Columns that are kept. Only ``step`` is required; in imitation it counts samples."""
_SECONDS: Final = "seconds_"  # prefix of the columns that say how long each part of the work took
_NAME: Final = re.compile(r"(?P<agent>[^.]+)(?:\.(?P<variant>[^.]+))?\.s(?P<seed>\d+)\.csv")


@dataclass(frozen=True)
class Curve:
    """Progress of one training run."""

    agent: str
    seed: int
    variant: str | None
    columns: Mapping[str, tuple[float, ...]]
    """Columns by name, with one value a row; NaN where the run has none."""

    @property
    def file_name(self) -> str:
        """Name of the file that stores the curve."""
        return f"{self.agent}{f'.{self.variant}' if self.variant else ''}.s{self.seed}.csv"

    def last(self, column: str) -> float:
        """Return a column's last value; NaN if it has none."""
        return next((value for value in reversed(self.columns.get(column, ())) if not math.isnan(value)), math.nan)

    def points(self, column: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the steps at which a column has values, and those values."""
        pairs = zip(self.columns["step"], self.columns.get(column, ()), strict=False)
        found = [(step, value) for step, value in pairs if not math.isnan(value)]
        return tuple(step for step, _ in found), tuple(value for _, value in found)

    def seconds(self) -> dict[str, float]:
        """Return the total seconds of each part of the work."""
        return {
            name.removeprefix(_SECONDS): _sum(column)
            for name, column in self.columns.items()
            if name.startswith(_SECONDS)
        }

    def thinned(self) -> "Curve":
        """Return about :data:`POINTS` rows, evenly along the run, and every row with a held-out evaluation."""
        rows = len(self.columns["step"])
        every = max(1, math.ceil(rows / POINTS))
        evaluated = self.columns.get(HELD_OUT, (math.nan,) * rows)
        even = [row for row in range(rows) if row % every == 0 or row == rows - 1]
        kept = sorted({*even, *(row for row, value in enumerate(evaluated) if not math.isnan(value))})
        if len(kept) > 3 * POINTS:  # nearly every row has an evaluation
            kept = even
        # The seconds of dropped rows are added to the next row that is kept.
        begins = [0, *(row + 1 for row in kept[:-1])]
        columns = {
            name: tuple(
                _sum(column[begin : row + 1]) if name.startswith(_SECONDS) else column[row]
                for begin, row in zip(begins, kept, strict=True)
            )
            for name, column in self.columns.items()
        }
        return replace(self, columns=columns)

    def write(self, directory: Path) -> Path:
        """Write the curve under its own file name, and return the path.

        Raises:
            ResultsError: The file cannot be written.
        """
        path = directory / self.file_name
        try:
            directory.mkdir(parents=True, exist_ok=True)
            with path.open("w", encoding="utf-8", newline="") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(self.columns)
                rows = zip(*self.columns.values(), strict=True)
                writer.writerows([_text(value) for value in row] for row in rows)
        except OSError as error:
            raise ResultsError(f"{path}: cannot be written ({error.strerror}); name another --directory") from error
        return path


def read_progress(path: Path, agent: str, seed: int, variant: str | None = None) -> Curve:
    """Read a run's ``progress.csv``, or a stored curve.

    Raises:
        ResultsError: The file cannot be read, has no steps, or holds something that is not a number.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ResultsError(f"{path}: cannot be read as a table of a training's progress ({error})") from error
    if not rows or "step" not in rows[0]:
        raise ResultsError(f"{path}: has no column 'step' with a row; give the progress.csv of a training run")
    try:
        kept = [name for name in rows[0] if name in _COLUMNS or str(name).startswith(_SECONDS)]
        columns = {name: tuple(_number(row[name]) for row in rows) for name in kept}
    except ValueError as error:
        raise ResultsError(f"{path}: {error}; give the progress.csv of a training run") from error
    return Curve(agent, seed, variant, columns)


def read_curves(directory: Path) -> tuple[Curve, ...]:
    """Read all curves of a directory; none if it does not exist.

    Returns:
        Curves of the paper's algorithms first, then by agent, variant and seed.

    Raises:
        ResultsError: A file is not a curve, or its name is not that of a curve.
    """
    curves = []
    for path in sorted(directory.glob("*.csv")):
        named = _NAME.fullmatch(path.name)
        if named is None:
            raise ResultsError(
                f"{path.name}: is not the name of a curve; call it AGENT.sSEED.csv or AGENT.VARIANT.sSEED.csv"
            )
        curves.append(read_progress(path, named["agent"], int(named["seed"]), named["variant"]))
    return tuple(sorted(curves, key=lambda curve: (*table_order(curve.agent), curve.variant or "", curve.seed)))


def standard(curves: Iterable[Curve]) -> dict[str, list[Curve]]:
    """Return the curves by agent, without those of ablations."""
    found: dict[str, list[Curve]] = {}
    for curve in curves:
        if curve.variant is None:
            found.setdefault(curve.agent, []).append(curve)
    return found


def training_table(curves: Iterable[Curve]) -> ReportTable:
    """Return a table with a row for each run of reinforcement learning: its steps, time, speed and final figures."""
    head = ("steps", "minutes", "median steps/s", "final reward", "final held-out success")
    return ReportTable("Training runs", ("agent", "seed", *head), _rows(curves, REWARD, (REWARD, ".1f")))


def imitation_table(curves: Iterable[Curve]) -> ReportTable:
    """Return the same table of runs of imitation, which learn from samples instead of steps."""
    head = ("samples", "minutes", "median samples/s", "final loss", "final held-out success", "beside traffic")
    rows = _rows(curves, LOSS, (LOSS, ".3f"), ("traffic_success_heldout", ".2f"))
    return ReportTable("Training runs of imitation", ("agent", "seed", *head), rows)


def _rows(
    curves: Iterable[Curve], having: str, measure: tuple[str, str], *more: tuple[str, str]
) -> tuple[tuple[str, ...], ...]:
    """Return a row for each curve that has a column.

    Args:
        curves: The curves.
        having: The column.
        measure: Name and format of the column whose last value stands before the held-out success.
        more: Those that stand behind it.
    """
    rows: dict[str, Rows] = {}
    for curve in curves:
        if having not in curve.columns:
            continue
        name = f"`{curve.agent}`" + (f", {curve.variant.replace('-', ' ')}" if curve.variant else "")
        speeds = curve.points("steps_per_second")[1]
        row = (
            str(curve.seed),
            f"{curve.last('step') / 1e6:.2f} M",
            _shown(curve.last("minutes"), ".1f"),
            _shown(median(speeds) if speeds else math.nan, ",.0f"),
            *(_shown(curve.last(column), form) for column, form in (measure, (HELD_OUT, ".2f"), *more)),
        )
        rows.setdefault(name, []).append(row)
    return tuple(row for name, own in rows.items() for row in label_first(name, own))


def time_table(curves: Iterable[Curve]) -> ReportTable:
    """Return a table of where the training time of each algorithm goes, in percent."""
    spent = {agent: [run.seconds() for run in runs] for agent, runs in standard(curves).items()}
    parts = tuple(dict.fromkeys(part for runs in spent.values() for seconds in runs for part in seconds))
    rows: Rows = []
    for agent, runs in spent.items():
        whole = sum(sum(seconds.values()) for seconds in runs)
        if whole > 0:
            shares = (f"{100 * sum(seconds.get(part, 0.0) for seconds in runs) / whole:.0f}" for part in parts)
            rows.append((f"`{agent}`", *shares))
    return ReportTable("Where the time of training goes, in %", ("agent", *parts), tuple(rows), text_columns=1)


def _sum(values: Iterable[float]) -> float:
    return math.fsum(value for value in values if not math.isnan(value))


def _number(text: str | None) -> float:
    value = math.nan if text is None or not text.strip() else float(text)
    if math.isinf(value):
        raise ValueError(f"{text!r} is not finite")
    return value


def _text(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.6g}" if abs(value) < 1e6 else f"{value:.0f}"


def _shown(value: float, form: str) -> str:
    return "–" if math.isnan(value) else f"{value:{form}}"
