"""Names of the judge and of the car that programs also find in ``wrongturn_sim``."""

from wrongturn_judge import (
    Appearance,
    JourneyGeometry,
    JourneyJudge,
    Judge,
    JudgeGeometry,
    Row,
    Trajectory,
    TrajectoryError,
    judge,
)
from wrongturn_protocol import VEHICLE, Vehicle

__all__ = [
    "VEHICLE",
    "Appearance",
    "JourneyGeometry",
    "JourneyJudge",
    "Judge",
    "JudgeGeometry",
    "Row",
    "Trajectory",
    "TrajectoryError",
    "Vehicle",
    "judge",
]
