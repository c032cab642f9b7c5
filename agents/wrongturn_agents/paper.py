"""Our agents that follow the designs of the reference paper's agents."""

from types import MappingProxyType
from typing import Final

from wrongturn_agents.doubting_agent import DOUBTING_AGENTS
from wrongturn_protocol import PAPER

PAPER_BY_NAME: Final = MappingProxyType({agent.ours: agent for agent in PAPER})
"""The paper's agents by the name of ours, in the order of its tables."""

ALGORITHMS: Final = tuple(PAPER_BY_NAME)
"""Names of our agents that follow the designs of the paper's agents, in the order of its tables."""

COMPARED: Final = ("ppo-segmentation", "ppo-image", "ppo-auxiliary")
"""Those of the agents that the paper's authors trained, from the most unsafe to the least. Others trained the rest."""

TRAINED_ON_FAULTS: Final = "†"
"""Marks agents that met wrong commands in their training."""


def label(agent: str) -> str:
    """Return an agent's name for a table, marked if it met wrong commands in its training."""
    return f"`{agent}` {TRAINED_ON_FAULTS}" if agent in DOUBTING_AGENTS else f"`{agent}`"


def table_order(agent: str) -> tuple[int, str]:
    """Return a sort key for agents: the paper's algorithms first, then by name."""
    return (ALGORITHMS.index(agent) if agent in ALGORITHMS else len(ALGORITHMS), agent)
