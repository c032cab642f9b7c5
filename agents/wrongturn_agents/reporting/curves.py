"""Learning curves: a training run's ``progress.csv``, thinned for storage; their tables and their picture."""

import csv
import hashlib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, Final

from wrongturn_agents.errors import MissingPackageError, OutdatedPageError, ResultsError
from wrongturn_agents.reporting.paper import table_order
from wrongturn_agents.reporting.tables import ReportTable, Rows, label_first

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PICTURE: Final = Path("docs/pictures/learning-curves.svg")
"""Picture of the learning curves, from the repository's root."""
POINTS: Final = 150
"""Number of rows kept of a run; a picture of a few hundred pixels shows no more."""
_COLUMNS: Final = ("step", "minutes", "reward_mean", "success_heldout", "steps_per_second")  # only step is required
_SECONDS: Final = "seconds_"  # prefix of the columns that say how long each part of the work took
_NAME: Final = re.compile(r"(?P<agent>[^.]+)(?:\.(?P<variant>[^.]+))?\.s(?P<seed>\d+)\.csv")
_COLOURS: Final = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#000000")
"""Okabe and Ito's palette, which colour-blind readers can tell apart."""
_DIGEST: Final = re.compile(r"curves sha256:([0-9a-f]{64})")


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
        evaluated = self.columns.get("success_heldout", (math.nan,) * rows)
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
    """Return a table with a row for each run: its steps, time, speed and final figures."""
    rows: dict[str, Rows] = {}
    for curve in curves:
        name = f"`{curve.agent}`" + (f", {curve.variant.replace('-', ' ')}" if curve.variant else "")
        speeds = curve.points("steps_per_second")[1]
        row = (
            str(curve.seed),
            f"{curve.last('step') / 1e6:.2f} M",
            _shown(curve.last("minutes"), ".1f"),
            _shown(median(speeds) if speeds else math.nan, ",.0f"),
            _shown(curve.last("reward_mean"), ".1f"),
            _shown(curve.last("success_heldout"), ".2f"),
        )
        rows.setdefault(name, []).append(row)
    head = ("agent", "seed", "steps", "minutes", "median steps/s", "final reward", "final held-out success")
    labelled = (row for name, own in rows.items() for row in label_first(name, own))
    return ReportTable("Training runs", head, tuple(labelled))


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


def draw(curves: Sequence[Curve], path: Path) -> None:
    """Draw reward and held-out success over environment steps, with a column for each agent and a line for each seed.

    Raises:
        MissingPackageError: matplotlib is not installed.
        ResultsError: There is nothing to draw, or the file cannot be written.
    """
    try:
        import matplotlib as mpl  # noqa: PLC0415 - comes with an extra
        from matplotlib.figure import Figure  # noqa: PLC0415
    except ImportError as error:
        raise MissingPackageError("matplotlib is not installed; install wrongturn-agents[figures]") from error
    agents = standard(curves)
    if not agents:
        raise ResultsError("--curves: no curve is stored; store one with 'wrongturn results --import RUN_DIRECTORY'")
    look: Any = {"svg.hashsalt": "wrongturn", "svg.fonttype": "none", "path.simplify": True, "font.size": 9}
    with mpl.rc_context(look):
        figure = Figure(figsize=(3.2 * len(agents), 4.4), layout="constrained")
        axes = figure.subplots(2, len(agents), squeeze=False, sharex="col", sharey="row")
        for column, (agent, runs) in enumerate(agents.items()):
            _draw_agent(axes[0, column], axes[1, column], runs)
            axes[0, column].set_title(agent)
            axes[1, column].set_xlabel("environment steps, million")
        axes[0, 0].set_ylabel("reward of a drive, mean")
        axes[1, 0].set_ylabel("held-out routes completed")
        note = {"Date": None, "Title": "Learning curves", "Description": f"curves sha256:{_digest(curves)}"}
        try:
            figure.savefig(path, format="svg", metadata=note)
        except OSError as error:
            raise ResultsError(
                f"--curves: {path} cannot be written ({error.strerror}); run it from the repository's root"
            ) from error


def check_picture(curves: Sequence[Curve], path: Path) -> None:
    """Check that a picture shows these curves.

    Raises:
        OutdatedPageError: The picture shows other curves, or is missing although there are curves.
    """
    if not standard(curves):
        return
    found = _DIGEST.search(path.read_text(encoding="utf-8")) if path.is_file() else None
    if found is None or found[1] != _digest(curves):
        raise OutdatedPageError(f"{path}: does not show the stored curves; draw it with 'wrongturn results --curves'")


def _digest(curves: Sequence[Curve]) -> str:
    """Return a hash of what is drawn. The picture holds it, so that a check need not draw it again."""
    drawn = [
        (curve.agent, curve.seed, sorted(curve.columns.items())) for of in standard(curves).values() for curve in of
    ]
    return hashlib.sha256(repr(drawn).encode()).hexdigest()


def _draw_agent(above: "Axes", below: "Axes", runs: Sequence[Curve]) -> None:
    for number, run in enumerate(runs):
        colour = _COLOURS[number % len(_COLOURS)]
        for axes, column in ((above, "reward_mean"), (below, "success_heldout")):
            steps, values = run.points(column)
            axes.plot([step / 1e6 for step in steps], values, color=colour, linewidth=1.0, label=f"seed {run.seed}")
    for axes in (above, below):
        axes.grid(visible=True, linewidth=0.4, alpha=0.5)
    below.set_ylim(-0.02, 1.02)
    above.legend(fontsize=7, frameon=False, loc="upper left")


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
