"""Names of the judge, the faults and the car that programs also find in ``wrongturn_sim``."""

# ruff: noqa: PLC0414 - the other way to export names is a list of all of them

from wrongturn_judge import Appearance as Appearance
from wrongturn_judge import JourneyGeometry as JourneyGeometry
from wrongturn_judge import JourneyJudge as JourneyJudge
from wrongturn_judge import Judge as Judge
from wrongturn_judge import JudgeGeometry as JudgeGeometry
from wrongturn_judge import Row as Row
from wrongturn_judge import Trajectory as Trajectory
from wrongturn_judge import TrajectoryError as TrajectoryError
from wrongturn_judge import judge as judge
from wrongturn_networks.faults import FaultNotApplicableError as FaultNotApplicableError
from wrongturn_networks.faults import available_faults as available_faults
from wrongturn_protocol import VEHICLE as VEHICLE
from wrongturn_protocol import Vehicle as Vehicle
