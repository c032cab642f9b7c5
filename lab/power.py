"""What ranks can show: the power of two intervals that do not touch, exactly, without simulation.

``python -m lab.power`` prints the table of ``docs/ranking.md``.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_judge.intervals import RANK_LEVEL, wilson

TRIALS: Final = 60
"""Trials of ``wrong-command@3``."""
POWER: Final = 0.8
"""Probability with which a difference has to show."""
OWNERS: Final = 10
"""Owners in the table's last column."""
RATES: Final = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5)
"""True unsafe rates of the safer agent in the table."""


@dataclass(frozen=True)
class Power:
    """What two agents' counts show about their true rates.

    Attributes:
        rate: True unsafe rate of the safer agent.
        shown: Least difference of the true rates, in trials of all, that shows with probability POWER. None if even an
            agent that is always unsafe does not show.
        power: Probability with which that difference shows.
        false_alarm: Probability that two agents of this same rate differ in rank.
    """

    rate: float
    shown: int | None
    power: float | None
    false_alarm: float


def power_at(rate: float, trials: int = TRIALS) -> Power:
    """Return the power for a safer agent of a true rate, from sums of binomial probabilities.

    Args:
        rate: True unsafe rate of the safer agent, 0 to 1.
        trials: Number of trials of each agent.
    """
    false_alarm = 2 * chance_below(rate, rate, trials)
    for difference in range(1, int(trials * (1 - rate) + 1e-9) + 1):
        power = chance_below(rate, rate + difference / trials, trials)
        if power >= POWER:
            return Power(rate, difference, power, false_alarm)
    return Power(rate, None, None, false_alarm)


def chance_below(first: float, second: float, trials: int = TRIALS) -> float:
    """Return the probability that the first agent's interval lies wholly below the second's.

    Args:
        first: True unsafe rate of the first agent.
        second: That of the second.
        trials: Number of independent trials of each agent.
    """
    from scipy.stats import binom

    counts = np.arange(trials + 1)
    return float(binom.pmf(counts, trials, first) @ _below(trials) @ binom.pmf(counts, trials, second))


def chance_behind(rate: float, owners: int, trials: int = TRIALS) -> float:
    """Return the probability that an agent is not first among equal agents of as many owners.

    Args:
        rate: True unsafe rate of them all.
        owners: Number of owners, with one agent each.
        trials: Number of independent trials of each agent.
    """
    from scipy.stats import binom

    chances = binom.pmf(np.arange(trials + 1), trials, rate)
    return float(chances @ (1 - (1 - chances @ _below(trials)) ** (owners - 1)))


@lru_cache(maxsize=8)
def _below(trials: int) -> NDArray[np.float64]:
    """Return for each pair of counts 1 if the first's interval lies wholly below the second's, else 0."""
    low, high = np.array([wilson(count, trials, RANK_LEVEL) for count in range(trials + 1)]).T
    return np.asarray(high[:, None] < low[None, :], dtype=np.float64)


def table() -> str:
    """Return the power over :data:`RATES` as a Markdown table."""
    heads = (
        "true rate of the safer agent",
        f"difference that shows, of {TRIALS}",
        "power",
        "two equal agents differ",
        f"an agent is not first among {OWNERS} equal ones",
    )
    lines = [f"| {' | '.join(heads)} |", "|---:" * len(heads) + "|"]
    for rate in RATES:
        found = power_at(rate)
        shown = "– | –" if found.shown is None or found.power is None else f"{found.shown} | {100 * found.power:.0f} %"
        alarms = found.false_alarm, chance_behind(rate, OWNERS)
        lines.append(f"| {100 * rate:.0f} % | {shown} | {100 * alarms[0]:.1f} % | {100 * alarms[1]:.1f} % |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(table(), end="")
