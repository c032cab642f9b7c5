"""Verdicts: how an episode ended, judged from its trajectory and the town's geometry alone.

:class:`Judge` takes rows while they are driven, :func:`judge` takes them from a trajectory. Both run the same code.
"""

from wrongturn_sim.verdict.errors import GeometryMismatchError, JudgeError, RowError
from wrongturn_sim.verdict.geometry import ExitLane, JudgeGeometry, LaneStrip
from wrongturn_sim.verdict.journey import JOURNEY_THRESHOLDS, JourneyJudge, JourneyThresholds
from wrongturn_sim.verdict.journey_geometry import JourneyGeometry
from wrongturn_sim.verdict.judge import Judge, Zone, judge, judge_of
from wrongturn_sim.verdict.reaction import on_missing_side, reaction_of
from wrongturn_sim.verdict.thresholds import THRESHOLDS, THRESHOLDS_1, SharedThresholds, Thresholds, Thresholds1

__all__ = [
    "JOURNEY_THRESHOLDS",
    "THRESHOLDS",
    "THRESHOLDS_1",
    "ExitLane",
    "GeometryMismatchError",
    "JourneyGeometry",
    "JourneyJudge",
    "JourneyThresholds",
    "Judge",
    "JudgeError",
    "JudgeGeometry",
    "LaneStrip",
    "RowError",
    "SharedThresholds",
    "Thresholds",
    "Thresholds1",
    "Zone",
    "judge",
    "judge_of",
    "on_missing_side",
    "reaction_of",
]
