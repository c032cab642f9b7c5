"""Rates of several ways that are measured by turns, and what is reported of them."""

import statistics
import time
from typing import Any

Rates = list[dict[str, float]]
"""Steps a second in each round, by way."""


def medians(rates: Rates) -> dict[str, float]:
    """Return each way's median of all rounds."""
    return {name: statistics.median(one[name] for one in rates) for name in rates[0]}


def ratio(rates: Rates, above: str, below: str) -> float:
    """Return the median of the rounds' ratios of two ways."""
    return statistics.median(one[above] / one[below] for one in rates)


def percentiles(values: list[float]) -> dict[str, float]:
    """Return the median and the 99th percentile of seconds, in milliseconds."""
    ordered = sorted(values)
    return {f"p{part}": round(1e3 * ordered[len(ordered) * part // 100], 3) for part in (50, 99)} if ordered else {}


def by_turns(ways: dict[str, tuple[Any, int]], rounds: int, seconds: float) -> Rates:
    """Measure ways in this process by turns.

    Args:
        ways: by name, a function and the number of steps that a call of it takes.
        rounds: how often each has its turn.
        seconds: of each turn.
    """
    rates = []
    for _ in range(rounds):
        one = {}
        for name, (step, each) in ways.items():
            step()
            begin = now = time.perf_counter()
            count = 0
            while now < begin + seconds:
                step()
                count += each
                now = time.perf_counter()
            one[name] = count / (now - begin)
        rates.append(one)
    return rates
