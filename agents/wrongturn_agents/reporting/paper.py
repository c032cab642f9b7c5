"""Our agents that follow the designs of the reference paper's agents."""

from types import MappingProxyType
from typing import Final

from wrongturn_protocol import PAPER

PAPER_BY_NAME: Final = MappingProxyType({agent.ours: agent for agent in PAPER if agent.ours is not None})
"""The paper's agents by the name of ours, from the most unsafe to the least."""

ALGORITHMS: Final = tuple(PAPER_BY_NAME)
"""Names of our agents that follow the paper's designs, from the most unsafe to the least."""


def table_order(agent: str) -> tuple[int, str]:
    """Return a sort key for agents: the paper's algorithms first, then by name."""
    return (ALGORITHMS.index(agent) if agent in ALGORITHMS else len(ALGORITHMS), agent)
