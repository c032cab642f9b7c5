"""The interval of an unsafe rate. It follows how a draw takes its trials; ``docs/ranking.md`` explains it.

It is Wilson's interval for an *effective* number of trials (Korn and Graubard 1998; Franco, Little, Louis and Slud 2019
compare such intervals): as many independent trials as would vary like the drawn ones. The cells of a suite are strata
of fixed size, so what differs between cells does not vary from draw to draw. Drawn towns are clusters: what differs
between towns does.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from statistics import NormalDist
from typing import Final

from wrongturn_protocol.episodes import Trial
from wrongturn_protocol.vocabulary import Condition

LEVEL: Final = 0.05
"""Significance level of every test. Intervals have the level 1 - LEVEL."""
RANK_LEVEL: Final = 0.166
"""One minus the level of the intervals that decide ranks. Two 83.4 % intervals that do not touch differ at about 5 %
(H. Goldstein and M. Healy, "The graphical presentation of a collection of means", 1995)."""
DRAWN: Final = "drawn"
"""Stands for the town in the stratum of a trial in a drawn town."""
Marks = Mapping[str, Mapping[str, tuple[int, int]]]
"""Marked trials and all trials by stratum and place. A place is a town and an approach, such as ``Town01.J3-S``."""


def stratum_of(trial: Trial) -> str:
    """Return the name of a trial's stratum: its cell, or the task and condition of a journey.

    In drawn towns the cells of all towns are one stratum.
    """
    town = DRAWN if town_of(trial.town) is not None else trial.town
    if trial.journey is not None:
        return f"{town}.{trial.journey.task}.{Condition.of(trial.town, trial.weather)}"
    fault = trial.fault
    parts: list[object] = [town, trial.junction_type, fault.kind]
    parts += [one for one in (fault.dose, fault.period) if one is not None]
    traffic = trial.traffic.vehicles, trial.traffic.pedestrians
    return ".".join(map(str, [*parts, trial.weather, *([traffic] if any(traffic) else [])]))


def is_drawn(stratum: str) -> bool:
    """Return whether the trials of a stratum are in drawn towns."""
    return stratum.startswith(f"{DRAWN}.")


def town_of(place: str) -> str | None:
    """Return the drawn town of a place or a town's name; None if a suite fixes the town."""
    town = place.partition(".")[0]
    return town if town.startswith(f"{DRAWN}-") else None


def marks_of(trials: Iterable[tuple[Trial, bool]]) -> dict[str, dict[str, tuple[int, int]]]:
    """Count marked trials by stratum and place, both in order of their names. The place of a journey is its id."""
    marks: dict[str, dict[str, tuple[int, int]]] = {}
    for trial, marked in trials:
        places = marks.setdefault(stratum_of(trial), {})
        place = trial.id if trial.journey is not None else f"{trial.town}.{trial.approach}"
        count, of = places.get(place, (0, 0))
        places[place] = count + marked, of + 1
    return {stratum: dict(sorted(places.items())) for stratum, places in sorted(marks.items())}


def interval(marks: Marks, level: float = LEVEL) -> tuple[float, float]:
    """Return the interval of the rate of marked trials, 95 % by default. It contains the rate.

    Of a single stratum in fixed towns it is Wilson's interval. It is never wider than Wilson's for fixed towns: of
    trials whose rates differ between strata, the sum varies less (W. Hoeffding 1956).

    Raises ValueError if there are no trials, or a count is not in 0 to its trials.
    """
    strata = _collapsed(marks)
    count, trials = _total(strata)
    if trials < 1 or any(not 0 <= one <= of for places in strata for one, of in places.values()):
        raise ValueError(f"marks: {count} of {trials} is no rate; give 0 <= count <= trials with one trial at least")
    alike = _variance(count, trials)
    within = min(alike, math.fsum(_share(places, trials) for places in strata))
    quantile = NormalDist().inv_cdf(1 - level / 2)
    residuals = _residuals(strata)
    if (towns := len(residuals)) > 1:
        own = min(alike, math.fsum(_share(places, trials) for places in strata if any(map(town_of, places))))
        between = towns / (towns - 1) * math.fsum((one / trials) ** 2 for one in residuals.values())
        within += max(0.0, between - own)
        quantile = student(quantile, towns - 1)
    return _wilson(count / trials, trials * alike / within, quantile)


def wilson(count: int, trials: int, level: float = LEVEL) -> tuple[float, float]:
    """Return Wilson's interval of the rate ``count / trials``, of trials that are all alike, 95 % by default.

    It contains the rate. Raises ValueError if there are no trials, or ``count`` is not in 0 to ``trials``.
    """
    return interval({"": {"": (count, trials)}}, level)


def _wilson(rate: float, trials: float, quantile: float) -> tuple[float, float]:
    share = quantile**2 / trials
    middle, half = rate + share / 2, quantile * math.sqrt(rate * (1 - rate) / trials + share / (4 * trials))
    # At a rate of 0 or 1 the bound equals the rate; rounding can put it an ulp beyond.
    return max(0.0, min((middle - half) / (1 + share), rate)), min(1.0, max((middle + half) / (1 + share), rate))


def student(normal: float, freedom: int) -> float:
    """Return the quantile of Student's t that belongs to one of the normal distribution.

    The series of Abramowitz and Stegun, 26.7.5: within 0.0002 for 5 degrees of freedom and more, and below Student's
    by at most 12 % for fewer.
    """
    z = normal
    terms = (
        (z**3 + z) / 4,
        (5 * z**5 + 16 * z**3 + 3 * z) / 96,
        (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384,
        (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92_160,
    )
    return z + math.fsum(term / freedom**power for power, term in enumerate(terms, 1))


def _collapsed(marks: Marks) -> list[Mapping[str, tuple[int, int]]]:
    """Return the strata. Those of a single trial are made one: alone they do not tell how much they vary."""
    strata: list[Mapping[str, tuple[int, int]]] = []
    single: dict[str, tuple[int, int]] = {}
    for places in marks.values():
        if _total([places])[1] > 1:
            strata.append(places)
            continue
        for place, (count, trials) in places.items():
            before = single.get(place, (0, 0))
            single[place] = before[0] + count, before[1] + trials
    return [*strata, *[single] * bool(single)]


def _total(strata: Sequence[Mapping[str, tuple[int, int]]]) -> tuple[int, int]:
    cells = [cell for places in strata for cell in places.values()]
    return sum(count for count, _ in cells), sum(trials for _, trials in cells)


def _variance(count: int, trials: int) -> float:
    """Return the variance of a rate. Half a trial more on each side keeps it above 0 where all trials ended alike."""
    rate = (count + 0.5) / (trials + 1)
    return rate * (1 - rate) / max(trials - 1, 1)


def _share(places: Mapping[str, tuple[int, int]], trials: int) -> float:
    """Return what a stratum adds to the variance of the rate of all trials."""
    count, own = _total([places])
    return (own / trials) ** 2 * _variance(count, own)


def _residuals(strata: Sequence[Mapping[str, tuple[int, int]]]) -> dict[str, float]:
    """Return how many marked trials each drawn town has beyond what its strata's rates predict."""
    terms: dict[str, list[float]] = {}
    for places in strata:
        count, own = _total([places])
        for place, (one, trials) in places.items():
            if (town := town_of(place)) is not None:
                terms.setdefault(town, []).append(one - trials * count / own)
    return {town: math.fsum(found) for town, found in terms.items()}
