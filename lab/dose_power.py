"""How well 60 trials tell D50: simulated agents with a known one.

``python -m lab.dose_power`` prints the table of ``docs/dose.md``.
"""

from typing import Final

import numpy as np

from lab.tables import Row, Table
from wrongturn_networks.faults import Dose, fault_class
from wrongturn_protocol import FaultKind
from wrongturn_statistics.dose_response import DoseResponse

TRIALS, RUNS = 60, 200
"""Trials of a run, and runs of each agent."""
NEAR: Final = 0.2
"""D50 has to be right within this share."""
TRUE: Final = (6.0, 15.0, 25.0)
"""True D50 of a command that comes too late, metres."""
WIDTHS: Final = (1.0, 5.0, 10.0, 15.0)
"""Over how many metres the rate rises from 10 to 90 % of its rise."""
ENDS: Final = ((0.0, 0.0), (0.05, 0.1))
"""Shares of trials that fail at no dose, and that fail at none."""
_SEED: Final = 32


def late() -> Dose:
    """Return the range of doses of ``late``."""
    dose = fault_class(FaultKind.LATE).dose
    assert dose is not None
    return dose


def run(d50: float, width: float, ends: tuple[float, float], random: np.random.Generator) -> DoseResponse:
    """Return what trials of a simulated agent say."""
    response, (easy, hard) = DoseResponse(late()), ends
    scale = width / (2 * np.log(9))
    middle = d50 - scale * np.log((0.5 - easy) / (0.5 - hard))
    for _ in range(TRIALS):
        dose = response.best()
        rate = easy + (1 - easy - hard) / (1 + np.exp(-(dose - middle) / scale))
        response.add(dose, failed=bool(random.random() < rate))
    return response


def found(d50: float, width: float, ends: tuple[float, float]) -> tuple[float, float, float]:
    """Return how often D50 is right within NEAR and inside its interval, and its root mean square error, metres."""
    random = np.random.default_rng([_SEED, *(round(100 * one) for one in (d50, width, *ends))])
    got = [run(d50, width, ends, random).d50() for _ in range(RUNS)]
    # Outside the range there is a bound alone, which the range's end stands for.
    middle = np.array([late().high if one.value is None else one.value for one in got])
    inside = [(one.low is None or one.low <= d50) and (one.high is None or d50 <= one.high) for one in got]
    near = np.array([one.value is not None for one in got]) & (abs(middle - d50) <= NEAR * d50)
    return float(near.mean()), float(np.mean(inside)), float(np.sqrt(((middle - d50) ** 2).mean()))


def table() -> Table:
    """Return the table over TRUE, WIDTHS and ENDS."""
    rows: list[Row] = []
    for width in WIDTHS:
        for d50 in TRUE:
            row = [f"{width:g} m", f"{d50:g} m"]
            for ends in ENDS:
                near, inside, error = found(d50, width, ends)
                row += [f"{100 * near:.0f} %", f"{100 * inside:.0f} %", f"{error:.1f} m"]
            rows.append(tuple(row))
    each = (f"within {100 * NEAR:.0f} %", "inside the interval", "error")
    head = [f"{100 * easy:g} and {100 * hard:g} %: {what}" for easy, hard in ENDS for what in each]
    return Table("Dose", ("from 10 to 90 %", "true D50", *head), rows, words=0)


if __name__ == "__main__":
    print(table().markdown())
