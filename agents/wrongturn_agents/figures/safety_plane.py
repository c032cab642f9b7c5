"""The plane of obedience and safety: what an agent does with right commands across, and with wrong ones up."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from wrongturn_agents.figures.evaluation_record import EvaluationRecord, checked
from wrongturn_agents.figures.look import COLUMN, new_figure, style
from wrongturn_protocol import Verdict
from wrongturn_protocol.standing_rows import wilson

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIZE: Final = 6.5
"""Size of the labels' letters, points."""
_LETTER: Final = 0.6 * _SIZE
"""Width of a letter, points; a little too much is harmless."""
_LINE: Final = 1.25 * _SIZE
_MARK: Final = 3.0
"""Half the width of a mark, points."""
_MARGIN: Final = 3.0
"""Room beyond 0 and 100 %, percent: most marks are near these."""
_BESIDE: Final = 0.8
"""Agents that complete more of their twins have their labels at the right of the field: many are at its edge."""
_INTERVAL: Final = "#999999"


@dataclass(frozen=True)
class _Box:
    """A rectangle in percent of both axes."""

    left: float
    right: float
    low: float
    high: float

    def meets(self, other: "_Box") -> bool:
        return self.left < other.right and other.left < self.right and self.low < other.high and other.low < self.high


@dataclass(frozen=True)
class _Mark:
    """Agents with the same figures: rates and their intervals, percent."""

    x: float
    y: float
    wide: tuple[float, float]
    high: tuple[float, float]

    @classmethod
    def of(cls, done: int, unsafe: int, pairs: int) -> "_Mark":
        across, up = (tuple(100 * bound for bound in wilson(count, pairs)) for count in (done, unsafe))
        return cls(100 * done / pairs, 100 * unsafe / pairs, (across[0], across[1]), (up[0], up[1]))

    def boxes(self, half_width: float, half_height: float) -> Iterator[_Box]:
        """Yield what no label may cover: the intervals, as broad as the mark."""
        yield _Box(self.wide[0], self.wide[1], self.y - half_height, self.y + half_height)
        yield _Box(self.x - half_width, self.x + half_width, self.high[0], self.high[1])


@dataclass(frozen=True)
class _Place:
    """Where a label stands."""

    box: _Box
    x: float
    """Where its anchor is, percent."""
    anchor: str
    """matplotlib's horizontal alignment."""
    apart: bool
    """Whether it needs a line to its mark."""


def obedience_safety(runs: Sequence[EvaluationRecord], *, width: float = COLUMN) -> "Figure":
    """Draw each agent's completed twins across and unsafe trials (strict) up, with Wilson's 95 % intervals.

    The best place is at the lower right. Agents with the same figures share a mark.

    Raises:
        ResultsError: There is no run, or its suite has no twins.
        MissingPackageError: matplotlib is not installed.
    """
    alike: dict[tuple[int, int, int], list[str]] = {}
    for run in checked(runs):
        pairs = list(run.pairs())
        done = sum(twin.result.verdict is Verdict.EXIT_COMMANDED for _, twin in pairs)
        unsafe = sum(trial.result.unsafe_strict for trial, _ in pairs)
        alike.setdefault((done, unsafe, len(pairs)), []).append(run.label)
    height = 0.8 * COLUMN
    beside = [names for (done, _, pairs), names in alike.items() if done / pairs > _BESIDE]
    room = width - 0.65 - _LETTER * max((len(name) for names in beside for name in names), default=0) / 72
    # Percent that a point of the paper is worth; the rest of the width and height holds scales and labels.
    across, up = ((100 + 2 * _MARGIN) / (72 * size) for size in (room, height - 0.6))
    with style():
        figure = new_figure(width, height)
        axes = figure.subplots()
        marks = [_Mark.of(*counts) for counts in alike]
        boxes = [box for mark in marks for box in mark.boxes(_MARK * across, _MARK * up)]
        low = -_MARGIN
        for mark, names in sorted(zip(marks, alike.values(), strict=True), key=lambda one: one[0].y):
            _draw(axes, mark)
            if names in beside:
                low = max(low, mark.y - _LINE * len(names) * up / 2)
                _label_beside(axes, mark, low + _LINE * len(names) * up / 2, names)
                low += _LINE * len(names) * up
                continue
            places = _places(mark, names, across, up)
            place = next((one for one in places if not any(map(one.box.meets, boxes))), None)
            if place is not None:
                boxes.append(place.box)
                _label(axes, mark, place, names)
        marked = any(run.trained_on_faults for run in runs)
        axes.set_xlabel("twins completed, %" + "\n† met wrong commands in its training" * marked)
        axes.set_ylabel("unsafe trials, strict, %")
        for limits in (axes.set_xlim, axes.set_ylim):
            limits(-_MARGIN, 100 + _MARGIN)
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_axisbelow(True)
        axes.grid(linewidth=0.3, color="#cccccc")
    return figure


def _draw(axes: "Axes", mark: _Mark) -> None:
    """Draw a mark with its two intervals."""
    axes.errorbar(
        [mark.x],
        [mark.y],
        xerr=[[mark.x - mark.wide[0]], [mark.wide[1] - mark.x]],
        yerr=[[mark.y - mark.high[0]], [mark.high[1] - mark.y]],
        fmt="o",
        color="#000000",
        ecolor=_INTERVAL,
        ms=3.5,
        capsize=1.5,
        lw=0.6,
    )


def _places(mark: _Mark, names: Sequence[str], across: float, up: float) -> Iterator[_Place]:
    """Yield places for a label within the field, the best first: beside its mark, then farther above and below."""
    wide, high = _LETTER * max(map(len, names)) * across, _LINE * len(names) * up
    for step in range(60):
        middle = mark.y + (step + 1) // 2 * (-1) ** step * 0.5 * _LINE * up
        low, top = middle - high / 2, middle + high / 2
        apart = not low < mark.y < top
        for side, anchor in ((1, "left"), (-1, "right"), (0, "center")):
            near = (mark.wide[side > 0] if step == 0 else mark.x) + side * 1.5 * _MARK * across
            left = near - {"left": 0.0, "right": wide, "center": wide / 2}[anchor]
            if left >= -_MARGIN and left + wide <= 100 + _MARGIN and low >= -_MARGIN and top <= 100 + _MARGIN:
                yield _Place(_Box(left, left + wide, low, top), near, anchor, apart)


def _label_beside(axes: "Axes", mark: _Mark, y: float, names: Sequence[str]) -> None:
    """Write names at the right of the field, with a line to their mark."""
    axes.annotate(
        "\n".join(names),
        (mark.x, mark.y),
        (1.06, y),
        textcoords=("axes fraction", "data"),
        va="center",
        fontsize=_SIZE,
        arrowprops={"arrowstyle": "-", "lw": 0.4, "relpos": (0, 0.5), "shrinkA": 1, "shrinkB": 2},
    )


def _label(axes: "Axes", mark: _Mark, place: _Place, names: Sequence[str]) -> None:
    axes.annotate(
        "\n".join(names),
        (mark.x, mark.y),
        (place.x, (place.box.low + place.box.high) / 2),
        ha=place.anchor,
        va="center",
        fontsize=_SIZE,
        arrowprops={"arrowstyle": "-", "lw": 0.4, "shrinkA": 0, "shrinkB": 2} if place.apart else None,
    )
