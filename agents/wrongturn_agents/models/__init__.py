"""The networks of the paper's three agents (Carton et al., "Evaluating Robustness over High Level Driving Instruction
for Autonomous Driving", section "Evaluated agents"). They need the extra ``training``.

``build("ppo-segmentation" | "ppo-image" | "ppo-auxiliary")`` makes one; :class:`Homoscedastic` joins two losses.
"""

from wrongturn_agents.models.actor_critic import ActorCritic
from wrongturn_agents.models.build import ALGORITHMS, build
from wrongturn_agents.models.homoscedastic import Homoscedastic

__all__ = ["ALGORITHMS", "ActorCritic", "Homoscedastic", "build"]
