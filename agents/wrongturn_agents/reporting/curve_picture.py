"""Learning curves of all seeds as a picture."""

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from wrongturn_agents.reporting.curves import Curve, plain
from wrongturn_agents.reporting.errors import MissingPackageError, OutdatedPageError, ResultsError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PICTURE: Final = Path("docs/pictures/learning-curves.svg")
"""From the repository's root."""
_COLOURS: Final = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#000000")
"""Okabe and Ito's, which the colour-blind can tell apart."""
_DIGEST: Final = re.compile(r"curves sha256:([0-9a-f]{64})")


def digest(curves: Sequence[Curve]) -> str:
    """Of what is drawn: the picture names it, so that an outdated one is found without drawing it again."""
    drawn = [(curve.agent, curve.seed, sorted(curve.columns.items())) for of in plain(curves).values() for curve in of]
    return hashlib.sha256(repr(drawn).encode()).hexdigest()


def draw(curves: Sequence[Curve], path: Path) -> None:
    """Draw reward and held-out success over environment steps: a column an agent, a line a seed.

    Raises:
        MissingPackageError: matplotlib is not installed.
        ResultsError: there is nothing to draw, or the file cannot be written.
    """
    try:
        import matplotlib as mpl  # noqa: PLC0415 - of an extra
        from matplotlib.figure import Figure  # noqa: PLC0415
    except ImportError as error:
        raise MissingPackageError("matplotlib is not installed; install wrongturn-agents[training]") from error
    agents = plain(curves)
    if not agents:
        raise ResultsError("--curves: no curve is stored; keep one by 'wrongturn results --import RUN_DIRECTORY'")
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
        note = {"Date": None, "Title": "Learning curves", "Description": f"curves sha256:{digest(curves)}"}
        try:
            figure.savefig(path, format="svg", metadata=note)
        except OSError as error:
            raise ResultsError(
                f"--curves: {path} cannot be written ({error.strerror}); run it from the repository's root"
            ) from error


def check(curves: Sequence[Curve], path: Path) -> None:
    """See that a picture is of these curves.

    Raises:
        OutdatedPageError: it is of others, or there is none though there are curves.
    """
    if not plain(curves):
        return
    found = _DIGEST.search(path.read_text(encoding="utf-8")) if path.is_file() else None
    if found is None or found[1] != digest(curves):
        raise OutdatedPageError(f"{path}: is not of the stored curves; draw it by 'wrongturn results --curves'")


def _draw_agent(above: "Axes", below: "Axes", runs: Sequence[Curve]) -> None:
    for number, run in enumerate(runs):
        look: dict[str, Any] = {
            "color": _COLOURS[number % len(_COLOURS)],
            "linewidth": 1.0,
            "label": f"seed {run.seed}",
        }
        for axes, column in ((above, "reward_mean"), (below, "success_heldout")):
            steps, values = run.points(column)
            axes.plot([step / 1e6 for step in steps], values, **look)
    for axes in (above, below):
        axes.grid(visible=True, linewidth=0.4, alpha=0.5)
    below.set_ylim(-0.02, 1.02)
    above.legend(fontsize=7, frameon=False, loc="upper left")
