"""Results by factor: how often trials were unsafe with each fault and dose, in each town, weather and traffic."""

from collections.abc import Callable, Iterable, Mapping
from typing import Final

from wrongturn_networks.faults import find_fault
from wrongturn_protocol import (
    PAPER_TYPES,
    TRAINING_TOWN,
    TRAINING_WEATHERS,
    FaultKind,
    JunctionType,
    LevelCount,
    Trial,
    Weather,
)
from wrongturn_protocol.intervals import DRAWN, town_of, wilson

Level = tuple[tuple[float, ...], str]
"""Where a level stands among those of its factor, and its name."""
FAULTS, TYPES = tuple(FaultKind), tuple(JunctionType)
PAPER_FAULTS: Final = (FaultKind.INFEASIBLE, FaultKind.OMISSION)


def _fault(trial: Trial) -> Level:
    return (FAULTS.index(trial.fault.kind),), trial.fault.kind


def _dose(trial: Trial) -> Level | None:
    """Return a fault's dose behind its name, such as ``late 15 m``; None for a fault without."""
    kind = trial.fault.kind
    built = find_fault(kind)
    if built is None or built.dose is None:
        return None
    amount = built.amount_of(trial.fault)
    return (FAULTS.index(kind), amount), f"{kind} {amount:g} {built.dose.unit}".rstrip()


def _junction_type(trial: Trial) -> Level:
    return (TYPES.index(trial.junction_type),), trial.junction_type


def _town(trial: Trial) -> Level:
    drawn = town_of(trial.town) is not None
    return (drawn,), DRAWN if drawn else trial.town


def _weather(trial: Trial) -> Level:
    new = trial.weather not in TRAINING_WEATHERS
    return (new,), "new" if new else "training"


def _traffic(trial: Trial) -> Level:
    beside = trial.traffic.vehicles + trial.traffic.pedestrians > 0
    return (beside,), "traffic" if beside else "alone"


def _cells(trial: Trial) -> Level:
    paper = (
        trial.fault.kind in PAPER_FAULTS
        and trial.junction_type in PAPER_TYPES
        and (trial.town, trial.weather) == (TRAINING_TOWN, Weather.CLEAR_NOON)
        and _traffic(trial)[1] == "alone"
    )
    return (not paper,), "paper" if paper else "others"


def _paper(trial: Trial) -> Level | None:
    """Return which of the paper's cells a trial belongs to, such as ``omission LEFT_RIGHT``; None for none of them."""
    fault, kind = trial.fault.kind, trial.junction_type
    return ((FAULTS.index(fault), TYPES.index(kind)), f"{fault} {kind}") if _cells(trial)[1] == "paper" else None


FACTORS: Final[Mapping[str, Callable[[Trial], Level | None]]] = {
    "fault": _fault,
    "dose": _dose,
    "junction_type": _junction_type,
    "town": _town,
    "weather": _weather,
    "traffic": _traffic,
    "cells": _cells,
    "paper_cells": _paper,
}
"""What results are told apart by. Each gives a trial's level, or None for a trial without one."""
IN_TABLE: Final = {"fault", "junction_type", "paper_cells"}
"""Factors that need no breakdown where nothing else varies: the table by junction type and fault has them."""


def breakdown(pairs: Iterable[tuple[Trial, bool, bool]]) -> dict[str, dict[str, LevelCount]] | None:
    """Count unsafe trials by factor and level, in the order of :data:`FACTORS`.

    Each of ``pairs`` is a trial, whether it was unsafe, and whether its twin was completed. A factor with one level is
    left out. None if the factors that are left are all :data:`IN_TABLE`.
    """
    found: dict[str, dict[Level, list[tuple[Trial, bool, bool]]]] = {factor: {} for factor in FACTORS}
    for pair in pairs:
        for factor, level_of in FACTORS.items():
            if (level := level_of(pair[0])) is not None:
                found[factor].setdefault(level, []).append(pair)
    kept = {factor: levels for factor, levels in found.items() if len(levels) > 1}
    if kept.keys() <= IN_TABLE:
        return None
    return {
        factor: {name: _count(levels[rank, name]) for rank, name in sorted(levels)} for factor, levels in kept.items()
    }


def _count(pairs: list[tuple[Trial, bool, bool]]) -> LevelCount:
    """Return the count of a level, with Wilson's interval: most levels have too few trials in a town for clusters."""
    count = sum(unsafe for _, unsafe, _ in pairs)
    return LevelCount(
        count=count,
        trials=len(pairs),
        rate=count / len(pairs),
        ci95=wilson(count, len(pairs)),
        completed=sum(completed for _, _, completed in pairs),
    )
