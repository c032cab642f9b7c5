"""Charts of unsafe rates, and of trials beside their twins."""

import math
from collections.abc import Sequence
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wrongturn_agents.records.evaluation_record import EvaluationRecord, checked
from wrongturn_figures.look import COLUMN, new_figure, rate_bar, style
from wrongturn_protocol.intervals import marks_of

_TWINS: Final = "#555555"
_PAIR_BARS: Final = (
    ("both safe", "#ffffff", ""),
    ("only the twin unsafe", "#56b4e9", "...."),
    ("both unsafe", "#888888", "xxxx"),
    ("only the trial unsafe", "#d55e00", "////"),
)
"""Ends of a trial and its twin in the strict column: words, colour, hatch."""


def unsafe_rates(runs: Sequence[EvaluationRecord], *, width: float = COLUMN) -> Figure:
    """Draw each agent's unsafe rate with its 95 % interval: the strict column, and the paper's below it.

    Crosses are the twins' rate in the strict column.

    Raises:
        ResultsError: There is no run, or its suite has no twins.
    """
    counted = {run.label: list(run.pairs()) for run in checked(runs)}
    with style():
        figure = new_figure(width, 0.75 + 0.3 * len(counted))
        axes = figure.subplots()
        for row, found in enumerate(counted.values()):
            strict = sum(trial.result.unsafe_strict for trial, _ in found)
            twins = sum(twin.result.unsafe_strict for _, twin in found)
            for above, column, marker, colour, filled, label in (
                (-0.14, "unsafe_strict", "o", "#000000", "#000000", "strict column"),
                (0.14, "unsafe", "s", "#0072b2", "#ffffff", "paper's column"),
            ):
                rate, reach = rate_bar(marks_of((one.trial, getattr(one.result, column)) for one, _ in found))
                look: dict[str, Any] = {"color": colour, "mfc": filled, "ms": 3.5, "capsize": 2, "lw": 0.8}
                axes.errorbar([rate], [row + above], xerr=reach, fmt=marker, label=label, clip_on=False, **look)
            axes.plot([100 * twins / len(found)], [row], "x", color=_TWINS, ms=4, label="twins, strict", clip_on=False)
            axes.annotate(
                f"{strict}/{len(found)}", (1.02, row), xycoords=("axes fraction", "data"), va="center", fontsize=6.5
            )
        axes.set_yticks(range(len(counted)), list(counted))
        axes.set_ylim(len(counted) - 0.5, -0.5)
        _percent_axis(axes, "unsafe trials, %")
        _legend_below(figure, axes, ("strict column", "paper's column", "twins, strict"), 3)
    return figure


def pairs(runs: Sequence[EvaluationRecord], *, width: float = COLUMN) -> Figure:
    """Draw how many trials and twins were unsafe in pairs, in the strict column: a bar for each agent.

    The figures beside the bars are the excess over the twins in points, and the p-value of McNemar's exact test.

    Raises:
        ResultsError: There is no run, or its suite has no twins.
    """
    counted = {run.label: pair_counts(run) for run in checked(runs)}
    with style():
        figure = new_figure(width, 0.85 + 0.26 * len(counted))
        axes = figure.subplots()
        for row, counts in enumerate(counted.values()):
            left, whole = 0.0, sum(counts)
            for count, (name, colour, hatch) in zip(counts, _PAIR_BARS, strict=True):
                share = 100 * count / whole
                axes.barh(row, share, 0.62, left, color=colour, hatch=hatch, edgecolor="#000000", lw=0.5, label=name)
                if share >= 6:
                    box = {"boxstyle": "square,pad=0.15", "facecolor": "#ffffff", "edgecolor": "none"}
                    axes.text(left + share / 2, row, str(count), ha="center", va="center", fontsize=6.5, bbox=box)
                left += share
            excess = 100 * (counts[3] - counts[1]) / whole
            text = f"{excess:+.0f}, p {_p_text(mcnemar(counts[3], counts[1]))}"
            axes.annotate(text, (1.02, row), xycoords=("axes fraction", "data"), va="center", fontsize=6.5)
        axes.set_yticks(range(len(counted)), list(counted))
        axes.set_ylim(len(counted) - 0.5, -0.5)
        _percent_axis(axes, "pairs of trial and twin, %")
        axes.annotate("excess", (1.02, -0.62), xycoords=("axes fraction", "data"), va="bottom", fontsize=6.5)
        _legend_below(figure, axes, [name for name, *_ in _PAIR_BARS], 2 if width < 5 else 4)
    return figure


def pair_counts(run: EvaluationRecord) -> tuple[int, int, int, int]:
    """Return how many pairs were safe in both, unsafe in the twin only, in both, and in the trial only (strict)."""
    found = [(trial.result.unsafe_strict, twin.result.unsafe_strict) for trial, twin in run.pairs()]
    return (
        found.count((False, False)),
        found.count((False, True)),
        found.count((True, True)),
        found.count((True, False)),
    )


def mcnemar(one: int, other: int) -> float:
    """Return the two-sided p-value of McNemar's exact test for the numbers of discordant pairs."""
    total = one + other
    tail = sum(math.comb(total, k) for k in range(min(one, other) + 1))
    return float(min(1.0, 2 * tail / 2**total))


def _legend_below(figure: Figure, axes: Axes, order: Sequence[str], columns: int) -> None:
    """Add a legend with one entry for each label, in this order."""
    handles, labels = axes.get_legend_handles_labels()
    found = dict(zip(labels, handles, strict=True))
    figure.legend([found[name] for name in order], order, loc="outside lower center", ncols=columns, frameon=False)


def _percent_axis(axes: Axes, label: str) -> None:
    axes.set_xlim(0, 100)
    axes.set_xlabel(label)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(axis="y", length=0)
    axes.set_axisbelow(True)
    axes.grid(axis="x", linewidth=0.3, color="#cccccc")


def _p_text(p: float) -> str:
    return "< 0.001" if p < 0.001 else f"= {p:.2g}"
