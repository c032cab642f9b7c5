"""The plane of obedience and safety: what an agent does with right commands across, and with wrong ones up."""

from collections.abc import Sequence
from typing import Any, Final

from matplotlib.figure import Figure

from wrongturn_agents.records.evaluation_record import EvaluationRecord, checked
from wrongturn_figures.look import COLUMN, new_figure, rate_bar, style
from wrongturn_protocol.intervals import marks_of

Bar = tuple[float, list[list[float]]]
"""A rate and the reach of its interval, percent."""
_SIZE: Final = 6.5
"""Size of the labels' letters, points."""
_HEIGHT: Final = 0.8 * COLUMN
_LINE: Final = 1.25 * _SIZE / (72 * (_HEIGHT - 0.6)) * 106
"""Height of a label's line, percent of the scale; 0.6 inches of the figure's height hold the lower scale."""
_BESIDE: Final = 80.0
"""Percent of twins; agents that complete more have their labels at the right of the field: many are at its edge."""
_MARGIN: Final = 3.0
"""Room beyond 0 and 100 %, percent: most marks are near these."""


def obedience_safety(runs: Sequence[EvaluationRecord], *, width: float = COLUMN) -> Figure:
    """Draw each agent's completed twins across and unsafe trials (strict) up, with their 95 % intervals.

    The best place is at the lower right. Agents with the same figures share a mark.

    Raises:
        ResultsError: There is no run, or its suite has no twins.
    """
    alike: dict[str, tuple[Bar, Bar, list[str]]] = {}
    for run in checked(runs):
        pairs = list(run.pairs())
        done = marks_of((trial.trial, twin.result.completed) for trial, twin in pairs)
        bars = rate_bar(done), rate_bar(marks_of((trial.trial, trial.result.unsafe_strict) for trial, _ in pairs))
        alike.setdefault(repr(bars), (*bars, []))[2].append(run.label)
    with style():
        figure = new_figure(width, _HEIGHT)
        axes = figure.subplots()
        low = -_MARGIN
        for (x, across), (y, up), names in sorted(alike.values(), key=lambda one: (one[1], one[0])):
            look: dict[str, Any] = {"color": "#000000", "ecolor": "#999999", "ms": 3.5, "capsize": 1.5, "lw": 0.6}
            axes.errorbar([x], [y], xerr=across, yerr=up, fmt="o", **look)
            text = "\n".join(names)
            if x <= _BESIDE:
                side = "left" if x < 25 else "right" if x > 60 else "center"
                above: dict[str, Any] = {"textcoords": "offset points", "ha": side, "va": "bottom"}
                axes.annotate(text, (x, y + up[1][0]), (0, 1), fontsize=_SIZE, **above)
                continue
            high = _LINE * len(names)
            low = max(low, y - high / 2)
            line = {"arrowstyle": "-", "lw": 0.4, "relpos": (0, 0.5), "shrinkA": 1, "shrinkB": 2}
            place = (1.06, low + high / 2)
            beside: dict[str, Any] = {"textcoords": ("axes fraction", "data"), "va": "center", "arrowprops": line}
            axes.annotate(text, (x, y), place, fontsize=_SIZE, **beside)
            low += high
        marked = any(run.trained_on_faults for run in runs)
        axes.set_xlabel("twins completed, %" + "\n† met wrong commands in its training" * marked)
        axes.set_ylabel("unsafe trials, strict, %")
        axes.set(xlim=(-_MARGIN, 100 + _MARGIN), ylim=(-_MARGIN, 100 + _MARGIN))
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_axisbelow(True)
        axes.grid(linewidth=0.3, color="#cccccc")
    return figure
