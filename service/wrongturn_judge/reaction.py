"""The agent's reaction to the fault."""

from __future__ import annotations

from wrongturn_judge.geometry import JudgeGeometry
from wrongturn_judge.thresholds import Thresholds
from wrongturn_networks.faults import find_fault
from wrongturn_protocol import Command, Reaction, Trial, Verdict


def reaction_of(
    verdict: Verdict, x: float, y: float, trial: Trial, geometry: JudgeGeometry, thresholds: Thresholds
) -> Reaction | None:
    """Return the reaction, as the trial's fault names it, to a verdict with the body's centre at ``x, y`` metres."""
    fault = find_fault(trial.fault.kind)
    if fault is None:
        return None
    missing = trial.junction_type.missing
    return fault.reaction(verdict, lambda: on_missing_side(missing, x, y, geometry, thresholds))


def on_missing_side(
    missing: Command | None, x: float, y: float, geometry: JudgeGeometry, thresholds: Thresholds
) -> bool:
    """Return whether a point lies where the missing arm would be, or on the way there."""
    past, left = geometry.beside_approach(x, y)
    if missing is Command.LEFT:
        return past > -thresholds.obeyed_distance and left > 0
    if missing is Command.RIGHT:
        return past > -thresholds.obeyed_distance and left < 0
    if missing is Command.STRAIGHT:
        middle, _ = geometry.beside_approach(*geometry.middle)
        return past > middle and abs(left - geometry.street_axis) <= thresholds.obeyed_lateral
    return False
