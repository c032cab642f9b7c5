"""Learning curves: a training run's ``progress.csv``, thinned for storage; their tables and pictures."""

import hashlib
import json
import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from lab.tables import OutdatedPageError, Row, Table, label_first
from wrongturn_agents.errors import ResultsError
from wrongturn_agents.stored_results import table_order

LAB: Final = Path(__file__).parent / "stored"
"""What was driven and trained for this repository's own pages: ``curves/``, ``studies/``."""
POINTS: Final = 150
"""Number of rows kept of a run; a picture of a few hundred pixels shows no more."""
REWARD: Final = "reward_mean"
"""Column that runs of reinforcement learning have."""
LOSS: Final = "loss"
"""Column that runs of imitation have."""
HELD_OUT: Final = "success_heldout"
_COLUMNS: Final = ("step", "minutes", REWARD, LOSS, HELD_OUT, "traffic_success_heldout", "steps_per_second")
"""Columns that are kept. In imitation, ``step`` counts samples."""
_NAME: Final = re.compile(r"(?P<agent>[^.]+)(?:\.(?P<variant>[^.]+))?\.s(?P<seed>\d+)\.csv")
_COLOURS: Final = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#000000")
"""Okabe and Ito's palette, which colour-blind readers can tell apart."""
_DIGEST: Final = re.compile(r"curves sha256:([0-9a-f]{64})")


class Curve(NamedTuple):
    """Progress of one training run."""

    agent: str
    seed: int
    variant: str | None
    rows: pd.DataFrame

    @property
    def name(self) -> str:
        """The agent for a table, with its variant."""
        return f"`{self.agent}`" + (f", {self.variant.replace('-', ' ')}" if self.variant else "")

    def points(self, column: str) -> pd.DataFrame:
        """Return steps and values where a column has values."""
        has = column in self.rows
        return self.rows[["step", column]].dropna() if has else pd.DataFrame({"step": [], column: []})

    def last(self, column: str) -> float:
        """Return a column's last value; NaN if it has none."""
        found = list(self.rows[column].dropna()) if column in self.rows else []
        return float(found[-1]) if found else math.nan


def read_curves(folder: Path = LAB / "curves") -> tuple[Curve, ...]:
    """Return the curves of a folder: the paper's algorithms first, then by agent, variant and seed."""
    found = [(named, path) for path in folder.glob("*.csv") if (named := _NAME.fullmatch(path.name))]
    curves = [Curve(one["agent"], int(one["seed"]), one["variant"], pd.read_csv(path)) for one, path in found]
    return tuple(sorted(curves, key=lambda curve: (*table_order(curve.agent), curve.variant or "", curve.seed)))


def import_curve(run: Path, variant: str | None = None, folder: Path = LAB / "curves") -> Path:
    """Store the thinned curve of a training run's directory; of ``lbc``, those of both halves. Return the last path."""
    try:
        config = json.loads((run / "config.json").read_bytes())
        agent, seed = config["algorithm"], config["seed"]
        variant = variant or config.get("variant")
        parts = [("privileged.csv", f"{agent}-privileged")] if variant is None else []
        for name, whose in [*(one for one in parts if (run / one[0]).is_file()), ("progress.csv", agent)]:
            path = folder / f"{whose}{f'.{variant}' if variant else ''}.s{seed}.csv"
            rows = pd.read_csv(run / name, usecols=lambda column: column in _COLUMNS)
            thinned(rows).to_csv(path, index=False, float_format="%.6g")
    except (OSError, ValueError, KeyError) as error:
        raise ResultsError(f"{run}: is no directory of a training run ({error!r})") from error
    return path


def thinned(rows: pd.DataFrame) -> pd.DataFrame:
    """Return about :data:`POINTS` rows, evenly along the run, and every row with a held-out evaluation."""
    numbers = np.arange(len(rows))
    even = (numbers % max(1, math.ceil(len(rows) / POINTS)) == 0) | (numbers == len(rows) - 1)
    kept = even | rows[HELD_OUT].notna().to_numpy() if HELD_OUT in rows else even
    if kept.sum() > 3 * POINTS:  # nearly every row has an evaluation
        kept = even
    return rows[kept]


def training_table(curves: Iterable[Curve]) -> Table:
    """Return a row for each run of reinforcement learning: its steps, time, speed and final figures."""
    head = ("steps", "minutes", "median steps/s", "final reward", "final held-out success")
    return Table("Training runs", ("agent", "seed", *head), _rows(curves, {REWARD: ".1f", HELD_OUT: ".2f"}))


def imitation_table(curves: Iterable[Curve]) -> Table:
    """Return the same of runs of imitation, which learn from samples instead of steps."""
    head = ("samples", "minutes", "median samples/s", "final loss", "final held-out success", "beside traffic")
    rows = _rows(curves, {LOSS: ".3f", HELD_OUT: ".2f", "traffic_success_heldout": ".2f"})
    return Table("Training runs of imitation", ("agent", "seed", *head), rows)


def _rows(curves: Iterable[Curve], last: dict[str, str]) -> list[Row]:
    """Return a row for each curve that has the first of these columns; their last values are shown in these formats."""
    found: dict[str, list[Row]] = {}
    for curve in curves:
        if next(iter(last)) in curve.rows:
            speed = curve.points("steps_per_second")["steps_per_second"].median()
            ends = (_shown(curve.last(column), form) for column, form in last.items())
            steps, minutes = f"{curve.last('step') / 1e6:.2f} M", _shown(curve.last("minutes"), ".1f")
            row = (str(curve.seed), steps, minutes, _shown(speed, ",.0f"), *ends)
            found.setdefault(curve.name, []).append(row)
    return [row for name, own in found.items() for row in label_first(name, own)]


def _shown(value: float, form: str) -> str:
    return "–" if math.isnan(value) else f"{value:{form}}"


class Picture(NamedTuple):
    """A picture of the curves of one kind of learning: a column for each agent, a line for each run."""

    path: Path
    """Its path from the repository's root."""
    column: str
    """The column in the upper row. Curves that have it are drawn."""
    upper: str
    """What the upper row shows."""
    along: str
    """What the horizontal axis shows."""
    seen: str
    """The picture in a sentence."""

    def curves_of(self, curves: Iterable[Curve]) -> dict[str, list[Curve]]:
        """Return the curves that it shows, by agent."""
        found: dict[str, list[Curve]] = {}
        for curve in curves:
            if self.column in curve.rows:
                found.setdefault(curve.agent, []).append(curve)
        return found


PICTURES: Final = {
    "curves": Picture(
        Path("docs/pictures/learning-curves.svg"),
        REWARD,
        "reward of a drive, mean",
        "environment steps, million",
        "Reward and held-out success of every seed over environment steps",
    ),
    "imitation-curves": Picture(
        Path("docs/pictures/imitation-curves.svg"),
        LOSS,
        "error of the waypoints:\npixels left, metres right",
        "samples, million",
        "Loss and held-out success of every seed over samples",
    ),
}
"""All pictures by their section: of reinforcement learning, and of imitation."""


def check_pictures(curves: Sequence[Curve]) -> None:
    """Raise OutdatedPageError if a picture shows other curves."""
    for picture in PICTURES.values():
        found = _DIGEST.search(picture.path.read_text(encoding="utf-8"))
        if found is None or found[1] != _digest(picture.curves_of(curves)):
            raise OutdatedPageError(f"{picture.path}: does not show the stored curves; draw it with --curves")


def _digest(agents: dict[str, list[Curve]]) -> str:
    """Return a hash of what is drawn. The picture holds it, so that a check need not draw it again."""
    drawn = [
        (run.agent, run.variant, run.seed, sorted((str(name), tuple(map(float, run.rows[name]))) for name in run.rows))
        for runs in agents.values()
        for run in runs
    ]
    return hashlib.sha256(repr(drawn).encode()).hexdigest()


def draw_picture(picture: Picture, curves: Sequence[Curve]) -> None:
    """Draw a picture; a loss is on a logarithmic axis, with a unit of its own for each agent."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    agents, loss = picture.curves_of(curves), picture.column == LOSS
    look: Any = {"svg.hashsalt": "wrongturn", "svg.fonttype": "none", "path.simplify": True, "font.size": 9}
    with mpl.rc_context(look):
        figure = Figure(figsize=(3.2 * len(agents), 4.4), layout="constrained")
        axes = figure.subplots(2, len(agents), squeeze=False, sharex="col", sharey=False if loss else "row")
        for column, (agent, runs) in enumerate(agents.items()):
            above, below = axes[0, column], axes[1, column]
            _draw_agent(picture, above, below, runs)
            above.set_title(agent)
            below.set_xlabel(picture.along)
            if not any(len(run.points(HELD_OUT)) for run in runs):
                below.remove()
                above.set_xlabel(picture.along)
                above.tick_params(labelbottom=True)
        axes[0, 0].set_ylabel(picture.upper)
        axes[1, 0].set_ylabel("held-out routes completed")
        note = {"Date": None, "Title": "Learning curves", "Description": f"curves sha256:{_digest(agents)}"}
        figure.savefig(picture.path, format="svg", metadata=note)


def _draw_agent(picture: Picture, above: Any, below: Any, runs: Sequence[Curve]) -> None:
    from matplotlib.ticker import LogLocator

    for number, run in enumerate(runs):
        name = f"{run.variant.replace('-', ' ')} {run.seed}" if run.variant else f"seed {run.seed}"
        for axes, column in ((above, picture.column), (below, HELD_OUT)):
            found = run.points(column)
            axes.plot(
                found["step"] / 1e6,
                found[column],
                color=_COLOURS[number % len(_COLOURS)],
                linewidth=1.0,
                linestyle="dashed" if run.variant else "solid",
                marker="." if len(found) < 3 else "",
                label=name,
            )
    for axes in (above, below):
        axes.grid(visible=True, linewidth=0.4, alpha=0.5)
    below.set_ylim(-0.02, 1.02)
    if picture.column == LOSS:
        above.set_yscale("log", subs=())
        above.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        above.yaxis.set_major_formatter("{x:g}")
    above.legend(fontsize=7, frameon=False, loc="upper right" if picture.column == LOSS else "lower right")
