"""Wrongturn's simulation: towns on SUMO, a car, command faults and episodes, judged by their trajectories.

Names are imported when they are first used, so a command's help and the doctor need neither SUMO nor a compiler.
"""

import importlib
from typing import TYPE_CHECKING, Any

import gymnasium

from wrongturn_sim.home import set_cache

set_cache()  # before numba is imported anywhere

if TYPE_CHECKING:
    from wrongturn_sim.ego import VEHICLE, Vehicle
    from wrongturn_sim.episode import Episode, Step
    from wrongturn_sim.errors import (
        EpisodeAlreadyFinishedError,
        EpisodeNotStartedError,
        InvalidActionError,
        InvalidTrialError,
        SimError,
        SimulatorError,
        SimulatorFailedError,
        SimulatorInUseError,
        SimulatorUnavailableError,
        TrafficTooDenseError,
        TrajectoryError,
        TrialNotAloneError,
    )
    from wrongturn_sim.faults import FaultNotApplicableError, available_faults
    from wrongturn_sim.fleet.vector_env import WrongturnVectorEnv
    from wrongturn_sim.gym_env import WrongturnSimEnv
    from wrongturn_sim.simulator import Simulator
    from wrongturn_sim.trajectory import Row, Trajectory
    from wrongturn_sim.verdict import JourneyGeometry, JourneyJudge, Judge, JudgeGeometry, judge

_MODULES = {
    "ego": ("VEHICLE", "Vehicle"),
    "episode": ("Episode", "Step"),
    "faults": ("FaultNotApplicableError", "available_faults"),
    "fleet.vector_env": ("WrongturnVectorEnv",),
    "gym_env": ("WrongturnSimEnv",),
    "simulator": ("Simulator",),
    "trajectory": ("Row", "Trajectory"),
    "verdict": ("JourneyGeometry", "JourneyJudge", "Judge", "JudgeGeometry", "judge"),
}
"""Modules of the public names; all others are in ``errors``."""
_HOME = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME.get(name, 'errors')}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


gymnasium.register(
    id="WrongturnSim-v0",
    entry_point="wrongturn_sim.gym_env:WrongturnSimEnv",
    vector_entry_point="wrongturn_sim.fleet.vector_env:WrongturnVectorEnv",
)

__all__ = [
    "VEHICLE",
    "Episode",
    "EpisodeAlreadyFinishedError",
    "EpisodeNotStartedError",
    "FaultNotApplicableError",
    "InvalidActionError",
    "InvalidTrialError",
    "JourneyGeometry",
    "JourneyJudge",
    "Judge",
    "JudgeGeometry",
    "Row",
    "SimError",
    "Simulator",
    "SimulatorError",
    "SimulatorFailedError",
    "SimulatorInUseError",
    "SimulatorUnavailableError",
    "Step",
    "TrafficTooDenseError",
    "Trajectory",
    "TrajectoryError",
    "TrialNotAloneError",
    "Vehicle",
    "WrongturnSimEnv",
    "WrongturnVectorEnv",
    "available_faults",
    "judge",
]
