"""Dose and response: at which dose half of the trials are unsafe (D50), and which dose to try next.

The rate of unsafe trials is ``a + (1 - a - b) F((z - m) / s)``: F is the logistic function, ``a`` the rate at no dose,
``b`` the share of trials that no dose makes unsafe (N. Prins 2012 on lapses: left out, they bias the rest). D50 takes
the place of ``m``: there the rate itself is one half. All combinations on a grid are weighed by Bayes' rule, so trials
that are all safe, or that a dose parts exactly, are no special case. Each dose is the one whose outcome is expected to
tell most about D50: the psi method (L. Kontsevich and C. Tyler 1999), marginal over the other parameters (N. Prins
2013). Nothing is drawn: the same outcomes give the same doses.
"""

from functools import cache
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wrongturn_networks.faults import Dose
from wrongturn_protocol.intervals import LEVEL

_Floats = NDArray[np.float64]
DOSES: Final = 61
"""Doses that are tried, evenly spread over the range."""
BEYOND: Final = 0.5
"""D50 is looked for so far outside the range too, as a share of it: there it is only bounded."""
_STEPS: Final = 401
"""Values of D50."""
_SCALES: Final = np.geomspace(0.005, 0.4, 10)
"""Values of ``s``, as shares of the range."""
_ENDS: Final = (0.0, 0.03, 0.1, 0.2)
"""Values of ``a`` and of ``b``."""
_WIDTH: Final = 2 * float(np.log(9))
"""F rises from 10 to 90 % over so many ``s``."""


class Estimate(NamedTuple):
    """A number and its 95 % interval. None: outside the range of doses."""

    value: float | None
    low: float | None
    high: float | None


class DoseResponse:
    """What outcomes so far say of D50.

    Args:
        dose: The range, and which of its ends is harder.
    """

    def __init__(self, dose: Dose) -> None:
        self._dose = dose
        self._weights = np.full((_STEPS, len(_SCALES) * len(_ENDS) ** 2), 1.0)
        self._weights /= self._weights.size

    def add(self, dose: float, *, failed: bool) -> None:
        """Take the outcome of a trial with a dose."""
        rates = _rates(np.array([(dose - self._of(0)) / (self._of(1) - self._of(0))]))[0]
        self._weights *= rates if failed else 1 - rates
        self._weights /= self._weights.sum()

    def best(self) -> float:
        """Return the dose whose outcome is expected to tell most about D50."""
        given = np.matmul(_tried(), self._weights[:, :, None])[:, :, 0]  # probability of D50 and an unsafe trial
        prior = self._weights.sum(axis=1)[:, None]
        told = _entropy(given.sum(axis=0)) - (prior * _entropy(given / np.maximum(prior, 1e-300))).sum(axis=0)
        return self._of(float(np.linspace(0, 1, DOSES)[int(np.argmax(told))]))

    def d50(self) -> Estimate:
        """Return D50: the median of its probability and, at 95 %, its interval."""
        ends = [self._quantile(share) for share in (0.5, LEVEL / 2, 1 - LEVEL / 2)]
        value, *sides = (self._of(end) if 0 <= end <= 1 else None for end in ends)
        return Estimate(value, *(sides if self._dose.more_is_worse else reversed(sides)))

    def side(self) -> Literal["easier", "harder"] | None:
        """Return on which side of the range the median of D50 lies; None within it."""
        middle = self._quantile(0.5)
        return "easier" if middle < 0 else "harder" if middle > 1 else None

    def width(self) -> Estimate:
        """Return over how much dose the logistic function rises from 10 to 90 %."""
        chances = self._weights.reshape(_STEPS, len(_SCALES), -1).sum(axis=(0, 2)).cumsum()
        found = [float(np.interp(share, chances, _SCALES)) for share in (0.5, LEVEL / 2, 1 - LEVEL / 2)]
        return Estimate(*(_WIDTH * one * (self._dose.high - self._dose.low) for one in found))

    def _quantile(self, share: float) -> float:
        """Return the quantile of D50, as a share of the range."""
        step = (1 + 2 * BEYOND) / (_STEPS - 1)
        chances = np.concatenate([[0.0], self._weights.sum(axis=1).cumsum()])
        return float(np.interp(share, chances, -BEYOND + step * (np.arange(_STEPS + 1) - 0.5)))

    def _of(self, share: float) -> float:
        """Return the dose at a share of the range, counted from its easy end."""
        low, high = self._dose.low, self._dose.high
        ends = (low, high) if self._dose.more_is_worse else (high, low)
        return round(ends[0] + share * (ends[1] - ends[0]), 4)


@cache
def _tried() -> _Floats:
    """Return the rate at each dose that is tried for all combinations, (_STEPS, DOSES, n)."""
    return np.ascontiguousarray(_rates(np.linspace(0, 1, DOSES)).transpose(1, 0, 2))


def _rates(shares: _Floats) -> _Floats:
    """Return the rate of unsafe trials at shares of the range for all combinations, (len(shares), _STEPS, n)."""
    d50 = np.linspace(-BEYOND, 1 + BEYOND, _STEPS)[:, None, None, None]
    scale, a, b = np.meshgrid(_SCALES, _ENDS, _ENDS, indexing="ij")
    middle = d50 - scale * np.log((0.5 - a) / (0.5 - b))
    z = (shares[:, None, None, None, None] - middle) / scale
    rates = a + (1 - a - b) / (1 + np.exp(np.clip(-z, -700, 700)))
    # Rates of 0 and 1 would rule out what rounding alone decides.
    clipped: _Floats = np.clip(rates.reshape(len(shares), _STEPS, -1), 1e-9, 1 - 1e-9)
    return clipped


def _entropy(rate: _Floats) -> _Floats:
    """Return the entropy of outcomes with a probability."""
    inside = np.clip(rate, 1e-12, 1 - 1e-12)
    found: _Floats = -(inside * np.log(inside) + (1 - inside) * np.log(1 - inside))
    return found
