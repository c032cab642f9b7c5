"""Interval bars. All bars of a table share one axis, from 0 to 100 %."""

from dataclasses import dataclass
from typing import Final

WIDTH: Final = 200
"""Length of the axis in pixels. The style sheet draws its lines at the same places."""
TICKS: Final = tuple((percent, WIDTH * percent // 100) for percent in (0, 25, 50, 75, 100))
"""The scale: percent, and pixels from the left."""


@dataclass(frozen=True)
class Bar:
    """A rate with its intervals, in pixels along the axis."""

    value: float
    wide: tuple[float, float]
    """The 95 % interval, or the range over training seeds: a thin line."""
    narrow: tuple[float, float] | None
    """The 83.4 % interval, which decides the rank: a thick line. None if nothing is ranked by it."""
    style: str
    """Class in the style sheet: ``unsafe``, ``success`` or ``reference``."""


def bar(
    rate: float, wide: tuple[float, float], narrow: tuple[float, float] | None = None, style: str = "unsafe"
) -> Bar:
    """Return the bar of a rate. All rates are between 0 and 1."""
    return Bar(_pixels(rate), _both(wide), None if narrow is None else _both(narrow), style)


def _both(ends: tuple[float, float]) -> tuple[float, float]:
    return _pixels(ends[0]), _pixels(ends[1])


def _pixels(rate: float) -> float:
    return round(0.5 + WIDTH * rate, 1)
