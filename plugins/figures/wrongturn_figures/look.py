"""The look of figures for a paper: sizes, fonts, colours with a second mark each, and files of the same bytes."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
from matplotlib.figure import Figure

from wrongturn_agents.errors import ResultsError
from wrongturn_agents.results_file import TrialResult
from wrongturn_protocol import Verdict
from wrongturn_protocol.intervals import Marks, interval
from wrongturn_protocol.junction_frame import shape
from wrongturn_protocol.words import name

COLUMN: Final = 3.5
"""Width of one column of an IEEE paper, inches."""
PAGE: Final = 7.16
"""Width of both columns, inches."""
FORMATS: Final = ("pdf", "svg", "png")
_DPI: Final = 300  # of PNG
_STYLE: Final[dict[str, Any]] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so figures are the same everywhere
    "font.size": 7,
    "axes.titlesize": 7,
    "axes.labelsize": 7,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 6.5,
    "axes.linewidth": 0.6,
    "lines.linewidth": 0.8,
    "hatch.linewidth": 0.5,
    "pdf.fonttype": 42,  # TrueType, embedded: what conferences' checks of PDFs want
    "svg.fonttype": "path",
    "svg.hashsalt": "wrongturn",
    "savefig.dpi": _DPI,
    "figure.facecolor": "white",
}
_NO_DATES: Final[dict[str, dict[str, None]]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {}}


@dataclass(frozen=True)
class Mark:
    """How the drives of one kind of end are drawn. Dash and marker tell it without colour."""

    name: str
    """Words of the legend."""
    colour: str
    """From Okabe and Ito's palette, which colour-blind readers can tell apart."""
    dash: Any
    """matplotlib's ``linestyle``."""
    marker: str
    """Marker at the last position."""


_MARKERS: Final = {"star": "*", "cross": "X", "block": "s", "triangle": "^", "bar": "_", "dot": "o", "diamond": "D"}
"""matplotlib's markers of the pages' shapes."""


def _of(verdict: Verdict, colour: str, dash: Any, words: str | None = None) -> Mark:
    return Mark(words or name(verdict), colour, dash, _MARKERS[shape(verdict)])


EXIT: Final = _of(Verdict.EXIT_COMMANDED, "#0072b2", "solid", "exit")
_OPPOSED: Final = _of(Verdict.EXIT_COMMANDED, "#56b4e9", (0, (5, 1)), "exit, unsafe in the strict column")
_NEITHER: Final = _of(Verdict.TIMEOUT, "#777777", (0, (1, 2)))
_BY_VERDICT: Final = {
    **dict.fromkeys((Verdict.EXIT_COMMANDED, Verdict.EXIT_ROUTE, Verdict.EXIT_OTHER, Verdict.ARRIVED), EXIT),
    Verdict.STOPPED_BEFORE_JUNCTION: _of(Verdict.STOPPED_BEFORE_JUNCTION, "#009e73", (0, (6, 1, 1, 1))),
    Verdict.WRONG_WAY: _of(Verdict.WRONG_WAY, "#e69f00", (0, (7, 2))),
    Verdict.UNFINISHED: _of(Verdict.UNFINISHED, "#e69f00", (0, (4, 3))),
    Verdict.OFF_ROAD: _of(Verdict.OFF_ROAD, "#d55e00", (0, (3, 1))),
    Verdict.COLLISION: _of(Verdict.COLLISION, "#000000", (0, (1, 1))),
    Verdict.STOPPED_IN_JUNCTION: _of(Verdict.STOPPED_IN_JUNCTION, "#cc79a7", (0, (4, 1, 1, 1, 1, 1))),
    Verdict.ABORTED: _of(Verdict.ABORTED, "#777777", (0, (2, 2))),
}
MARKS: Final = (EXIT, _OPPOSED, *dict.fromkeys(mark for mark in _BY_VERDICT.values() if mark is not EXIT), _NEITHER)
"""All marks, from safe to unsafe; the order of legends."""


def mark_of(result: TrialResult) -> Mark:
    """Return how a result is drawn. An exit that is unsafe in the strict column has a mark of its own."""
    mark = _BY_VERDICT.get(result.verdict, _NEITHER)
    return _OPPOSED if mark is EXIT and result.unsafe_strict else mark


@contextmanager
def style() -> Iterator[None]:
    """Draw and save in this look within the ``with`` block."""
    look: dict[Any, Any] = {**mpl.rcParamsDefault, **_STYLE}
    with mpl.rc_context(look):
        yield


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of this size, inches. Call it within :func:`style`."""
    return Figure(figsize=(width, height), layout="constrained")


def rate_bar(marks: Marks) -> tuple[float, list[list[float]]]:
    """Return the rate of marked trials, percent, and how far its 95 % interval reaches below and above it.

    The reach is in matplotlib's form.
    """
    cells = [cell for places in marks.values() for cell in places.values()]
    rate = 100 * sum(count for count, _ in cells) / sum(trials for _, trials in cells)
    low, high = (100 * bound for bound in interval(marks))
    return rate, [[rate - low], [high - rate]]


def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure as ``.pdf`` (fonts embedded), ``.svg`` (text as shapes) or ``.png`` (300 dpi); return the path.

    The same figure gives the same bytes with the same matplotlib.

    Raises:
        ResultsError: The file has another ending, or cannot be written.
    """
    path = Path(path)
    kind = path.suffix.removeprefix(".").lower()
    if kind not in FORMATS:
        raise ResultsError(f"{path}: ends in {path.suffix or 'nothing'}; choose one of .{', .'.join(FORMATS)}")
    try:
        with style():
            figure.savefig(path, format=kind, metadata=_NO_DATES[kind])
    except OSError as error:
        raise ResultsError(f"{path}: cannot be written ({error.strerror}); name another folder") from error
    return path
