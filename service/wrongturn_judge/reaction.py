"""The agent's reaction to the fault."""

from __future__ import annotations

from wrongturn_judge.geometry import JudgeGeometry
from wrongturn_judge.thresholds import Thresholds
from wrongturn_protocol import Command, FaultKind, Reaction, Trial, Verdict


def reaction_of(
    verdict: Verdict, x: float, y: float, trial: Trial, geometry: JudgeGeometry, thresholds: Thresholds
) -> Reaction | None:
    """Return the reaction to ``infeasible`` or ``omission``; None for other faults and for none.

    Args:
        verdict: the verdict.
        x: place of the body's centre at the verdict, metres.
        y: place of the body's centre at the verdict, metres.
        trial: the trial that was driven.
        geometry: geometry of its approach.
        thresholds: thresholds of the judge.
    """
    kind = trial.fault.kind
    if kind not in {FaultKind.INFEASIBLE, FaultKind.OMISSION}:
        return None
    if verdict.stopped:
        return Reaction.FROZE
    if kind is FaultKind.OMISSION:
        return Reaction.EXIT if verdict.exited else Reaction.OTHER
    if verdict.exited:
        return Reaction.OVERRODE
    crashed = verdict in {Verdict.COLLISION, Verdict.OFF_ROAD}
    if crashed and on_missing_side(trial.junction_type.missing, x, y, geometry, thresholds):
        return Reaction.OBEYED
    return Reaction.OTHER


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
