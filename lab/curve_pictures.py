"""Pictures of the learning curves: a column for each agent, a line for each run, dashed for an ablation."""

import hashlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from lab.curves import HELD_OUT, LOSS, REWARD, Curve
from wrongturn_agents.errors import MissingPackageError, OutdatedPageError, ResultsError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS: Final = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#000000")
"""Okabe and Ito's palette, which colour-blind readers can tell apart."""
_DIGEST: Final = re.compile(r"curves sha256:([0-9a-f]{64})")


@dataclass(frozen=True)
class Picture:
    """A picture of the curves of one kind of learning."""

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
    loss: bool = False
    """Whether the upper row shows a loss: on a logarithmic axis, with a unit of its own for each agent."""

    def curves_of(self, curves: Iterable[Curve]) -> dict[str, list[Curve]]:
        """Return the curves that it shows, by agent."""
        found: dict[str, list[Curve]] = {}
        for curve in curves:
            if self.column in curve.columns:
                found.setdefault(curve.agent, []).append(curve)
        return found


PICTURES: Final = (
    Picture(
        Path("docs/pictures/learning-curves.svg"),
        REWARD,
        "reward of a drive, mean",
        "environment steps, million",
        "Reward and held-out success of every seed over environment steps",
    ),
    Picture(
        Path("docs/pictures/imitation-curves.svg"),
        LOSS,
        "error of the waypoints:\npixels left, metres right",
        "samples, million",
        "Loss and held-out success of every seed over samples",
        loss=True,
    ),
)
"""All pictures: of reinforcement learning, and of imitation."""


def draw_pictures(curves: Sequence[Curve], pictures: Iterable[Picture] = PICTURES) -> list[Path]:
    """Draw each picture that has curves, and return the paths.

    Raises:
        MissingPackageError: matplotlib is not installed.
        ResultsError: There is nothing to draw, or a file cannot be written.
    """
    wanted = [picture for picture in pictures if picture.curves_of(curves)]
    if not wanted:
        raise ResultsError("--curves: no curve is stored; store one with --import RUN_DIRECTORY")
    for picture in wanted:
        _draw(picture, picture.curves_of(curves))
    return [picture.path for picture in wanted]


def check_pictures(curves: Sequence[Curve], pictures: Iterable[Picture] = PICTURES) -> None:
    """Check that the pictures show these curves.

    Raises:
        OutdatedPageError: One shows other curves, or is missing although there are curves.
    """
    for picture in pictures:
        drawn = picture.curves_of(curves)
        if not drawn:
            continue
        path = picture.path
        found = _DIGEST.search(path.read_text(encoding="utf-8")) if path.is_file() else None
        if found is None or found[1] != _digest(drawn):
            raise OutdatedPageError(
                f"{path}: does not show the stored curves; draw it with 'python -m lab.results --curves'"
            )


def _draw(picture: Picture, agents: dict[str, list[Curve]]) -> None:
    try:
        import matplotlib as mpl
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingPackageError("matplotlib is not installed; install wrongturn-agents[figures]") from error
    look: Any = {"svg.hashsalt": "wrongturn", "svg.fonttype": "none", "path.simplify": True, "font.size": 9}
    with mpl.rc_context(look):
        figure = Figure(figsize=(3.2 * len(agents), 4.4), layout="constrained")
        shared: Any = False if picture.loss else "row"
        axes = figure.subplots(2, len(agents), squeeze=False, sharex="col", sharey=shared)
        for column, (agent, runs) in enumerate(agents.items()):
            above, below = axes[0, column], axes[1, column]
            _draw_agent(picture, above, below, runs)
            above.set_title(agent)
            below.set_xlabel(picture.along)
            if not any(run.points(HELD_OUT)[0] for run in runs):
                below.remove()
                above.set_xlabel(picture.along)
                above.tick_params(labelbottom=True)
        axes[0, 0].set_ylabel(picture.upper)
        axes[1, 0].set_ylabel("held-out routes completed")
        note = {"Date": None, "Title": "Learning curves", "Description": f"curves sha256:{_digest(agents)}"}
        try:
            figure.savefig(picture.path, format="svg", metadata=note)
        except OSError as error:
            raise ResultsError(
                f"--curves: {picture.path} cannot be written ({error.strerror}); run it from the repository's root"
            ) from error


def _digest(agents: dict[str, list[Curve]]) -> str:
    """Return a hash of what is drawn. The picture holds it, so that a check need not draw it again."""
    drawn = [
        (curve.agent, curve.variant, curve.seed, sorted(curve.columns.items()))
        for runs in agents.values()
        for curve in runs
    ]
    return hashlib.sha256(repr(drawn).encode()).hexdigest()


def _draw_agent(picture: Picture, above: "Axes", below: "Axes", runs: Sequence[Curve]) -> None:
    from matplotlib.ticker import LogLocator

    for number, run in enumerate(runs):
        colour = _COLOURS[number % len(_COLOURS)]
        name = f"{run.variant.replace('-', ' ')} {run.seed}" if run.variant else f"seed {run.seed}"
        for axes, column in ((above, picture.column), (below, HELD_OUT)):
            steps, values = run.points(column)
            line = "dashed" if run.variant else "solid"
            marker = "." if len(values) < 3 else ""
            shown = [step / 1e6 for step in steps]
            axes.plot(shown, values, color=colour, linewidth=1.0, linestyle=line, marker=marker, label=name)
    for axes in (above, below):
        axes.grid(visible=True, linewidth=0.4, alpha=0.5)
    below.set_ylim(-0.02, 1.02)
    if picture.loss:
        above.set_yscale("log", subs=())
        above.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        above.yaxis.set_major_formatter("{x:g}")
    above.legend(fontsize=7, frameon=False, loc="upper right" if picture.loss else "lower right")
