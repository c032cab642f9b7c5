"""Learning to drive: the only part of the agents that knows the simulation. It needs the extra ``training``.

``training_cars`` gives a loop of your own many cars with the shipped curriculum. ``WrongturnVecEnv`` gives
Stable-Baselines3 any batch. ``Method``, ``Run`` and the settings' classes are for a method of your own
(``docs/extending.md``).
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wrongturn_agents.training.cars import training_cars
    from wrongturn_agents.training.drives_config import DrivesConfig
    from wrongturn_agents.training.method import Method, TrainedAgent
    from wrongturn_agents.training.run import Run, train
    from wrongturn_agents.training.settings import Settings
    from wrongturn_agents.training.vec_env import WrongturnVecEnv

_WHERE = {
    "DrivesConfig": "drives_config",
    "Method": "method",
    "Run": "run",
    "Settings": "settings",
    "TrainedAgent": "method",
    "WrongturnVecEnv": "vec_env",
    "train": "run",
    "training_cars": "cars",
}
__all__ = ["DrivesConfig", "Method", "Run", "Settings", "TrainedAgent", "WrongturnVecEnv", "train", "training_cars"]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_WHERE[name]}"), name)
