"""Learning to drive: the only part of the agents that knows the simulation. It needs the extra ``training``.

``WrongturnVecEnv`` gives Stable-Baselines3 many egos in this process.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wrongturn_agents.training.vec_env import WrongturnVecEnv

__all__ = ["WrongturnVecEnv"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.vec_env"), name)
