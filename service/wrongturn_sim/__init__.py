"""Wrongturn's simulation: towns on SUMO, a car, command faults and episodes, judged by their trajectories.

``__init__.pyi`` lists the public names. Each is loaded on first use, so that a command's help and the doctor need
neither SUMO nor a compiler.
"""

import gymnasium
import lazy_loader

from wrongturn_judge.home import set_cache
from wrongturn_protocol.variants import register_variants

set_cache()  # before numba is imported anywhere

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

gymnasium.register(
    id="WrongturnSim-v0",
    entry_point="wrongturn_sim.gym_env:WrongturnSimEnv",
    vector_entry_point="wrongturn_sim.fleet.vector_env:WrongturnVectorEnv",
)
register_variants("WrongturnSim", "wrongturn_sim.gym_env:WrongturnSimEnv")
