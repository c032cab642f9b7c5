"""The networks of the paper's three agents. They need the extra ``training``.

From Carton et al., "Evaluating Robustness over High Level Driving Instruction for Autonomous Driving" (2021), section
"Evaluated agents". :func:`build` makes a network by the algorithm's name. :class:`Homoscedastic` joins two losses.
"""

from wrongturn_agents.models.actor_critic import ALGORITHMS, ActorCritic, Homoscedastic, build

__all__ = ["ALGORITHMS", "ActorCritic", "Homoscedastic", "build"]
