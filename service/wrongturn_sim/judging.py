"""Names of the judge, the faults and the car that programs also find in ``wrongturn_sim``."""

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
from wrongturn_networks.faults import FaultNotApplicableError, available_faults
from wrongturn_protocol import VEHICLE, Vehicle

__all__ = [
    "VEHICLE",
    "Appearance",
    "FaultNotApplicableError",
    "JourneyGeometry",
    "JourneyJudge",
    "Judge",
    "JudgeGeometry",
    "Row",
    "Trajectory",
    "TrajectoryError",
    "Vehicle",
    "available_faults",
    "judge",
]
