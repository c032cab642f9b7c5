"""What fault, junction type, town, weather and traffic do to the strict unsafe rate, each beside the others.

A linear probability model: its coefficients are differences of rates themselves, and cells without a failure need no
special care (Y. Cheung, "A modified least-squares regression approach to the estimation of risk difference", 2007).
Trials at one junction, or in one drawn town, are not independent: they are clusters. With few of them the usual robust
variance is too small. So it is the bias-reduced one (L. Mancl and T. DeRouen, "A covariance estimator for GEE with
improved small-sample properties", 2001), with Student's t of one degree of freedom less than there are clusters.
"""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from wrongturn_agents.errors import ResultsError
from wrongturn_protocol import TRAINING_WEATHERS, FaultKind, JunctionType, Trial
from wrongturn_protocol.intervals import DRAWN, LEVEL, town_of

LEAST_CLUSTERS: Final = 6
"""With fewer clusters there is no interval."""
_ZERO: Final = 1e-12
"""Variances up to this are zero but for rounding, which leaves some 1e-18."""


class Observed(NamedTuple):
    """One trial and how it ended."""

    agent: str
    trial: Trial
    unsafe: bool


class Effect(NamedTuple):
    """What a level of a factor does, beside the factor's first level."""

    factor: str
    level: str
    reference: str
    unsafe: int
    trials: int
    difference: float | None
    """Of the rates, with all other factors alike. None where the trials cannot tell."""
    low: float | None
    high: float | None
    """Its 95 % interval."""
    p: float | None


class Effects(NamedTuple):
    """All effects of a set of trials."""

    effects: tuple[Effect, ...]
    trials: int
    clusters: int
    why_none: str | None
    """Why there is no difference at all, as a sentence; None if there are some."""


def _town(one: Observed) -> str:
    return DRAWN if town_of(one.trial.town) is not None else one.trial.town


FACTORS: Final[Mapping[str, Callable[[Observed], str]]] = {
    "agent": lambda one: one.agent,
    "fault": lambda one: one.trial.fault.kind.value,
    "junction_type": lambda one: one.trial.junction_type.value,
    "town": _town,
    "weather": lambda one: "training" if one.trial.weather in TRAINING_WEATHERS else "new",
    "traffic": lambda one: "traffic" if one.trial.traffic.vehicles + one.trial.traffic.pedestrians else "alone",
}
"""What trials differ in; the first level of each is the one that others are compared with."""
_ORDER: Final = (*map(str, FaultKind), *map(str, JunctionType), "training", "new", "alone", "traffic")


def cluster_of(trial: Trial) -> str:
    """Return the cluster of a trial: the town if it is drawn, else the junction, of which other towns have others."""
    return town_of(trial.town) or f"{trial.town}.{trial.approach.partition('-')[0]}"


def effects_of(observed: Sequence[Observed]) -> Effects:
    """Return the effects of all factors that vary.

    A level whose trials lie in a single cluster has none: nothing tells what that cluster adds of its own. Raises
    ResultsError if there are no trials.
    """
    if not observed:
        raise ResultsError("RUN: has no trials with a fault; give a run of a suite with faults")
    clusters = np.unique([cluster_of(one.trial) for one in observed], return_inverse=True)[1]
    levels = {name: [level_of(one) for one in observed] for name, level_of in FACTORS.items()}
    columns: dict[tuple[str, str], Any] = {}
    for name, values in levels.items():
        for level in sorted(dict.fromkeys(values), key=_rank):
            columns[name, level] = np.array([value == level for value in values], float)
    references = {name: next(level for factor, level in columns if factor == name) for name in levels}
    unsafe = np.array([one.unsafe for one in observed], float)
    rows = [key for key in columns if len(set(levels[key[0]])) > 1]
    # What a level in one cluster does cannot be told from what the cluster adds, so its trials are left out.
    known = {key for key in rows if len(set(clusters[columns[key] > 0])) > 1}
    kept = np.all([columns[key] == 0 for key in rows if key not in known] or [unsafe >= 0], axis=0)
    told = [key for key in rows if key in known and key[1] != references[key[0]]]
    for name, level in references.items():
        if (name, level) in rows and (name, level) not in known:  # another level of the factor stands for it
            told.remove(next(key for key in told if key[0] == name))
    design = np.column_stack([np.ones(len(observed)), *(columns[key] for key in told)])[kept]
    count, why = int(clusters.max()) + 1, None
    if unsafe.min() == unsafe.max():
        why = "All trials ended alike."
    elif count < LEAST_CLUSTERS:
        why = f"There are {count} junctions or drawn towns, and {LEAST_CLUSTERS} are needed."
    elif np.linalg.matrix_rank(design) < design.shape[1]:
        why = "The trials do not tell the factors apart: two of them vary together."
    fitted = dict(zip(told, _fit(unsafe[kept], design, clusters[kept]), strict=True)) if why is None else {}
    found = []
    for key in rows:
        own = columns[key] > 0
        shown = key in known and (key[0], references[key[0]]) in known
        numbers = fitted.get(key, (None,) * 4) if shown else (None,) * 4
        found.append(Effect(*key, references[key[0]], int(unsafe[own].sum()), int(own.sum()), *numbers))
    return Effects(tuple(found), len(observed), count, why)


def _rank(level: str) -> tuple[int, bool]:
    """Return where a level stands: in the vocabulary's order; else as they come, with drawn towns last."""
    return (_ORDER.index(level) if level in _ORDER else -1, level == DRAWN)


def _fit(unsafe: Any, design: Any, clusters: Any) -> list[tuple[float | None, ...]]:
    """Return difference, interval and p for each column of the design but the first; None where it has no variance."""
    from scipy.stats import t  # noqa: PLC0415 - slow
    from statsmodels.genmod.generalized_estimating_equations import GEE  # noqa: PLC0415

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = GEE(unsafe, design, groups=clusters).fit(cov_type="bias_reduced")
    freedom = len(set(clusters.tolist())) - 1
    found: list[tuple[float | None, ...]] = []
    # Not GEE's ``bse``: it takes the root of variances that are zero but for rounding, and so may be negative.
    for value, variance in zip(result.params[1:].tolist(), np.diag(result.cov_robust_bc)[1:].tolist(), strict=True):
        if not variance > _ZERO:  # nan too
            found.append((None,) * 4)
            continue
        deviation = math.sqrt(variance)
        half = float(t.ppf(1 - LEVEL / 2, freedom)) * deviation
        found.append((value, value - half, value + half, float(2 * t.sf(abs(value) / deviation, freedom))))
    return found
