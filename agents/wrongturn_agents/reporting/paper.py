"""The figures of the reference paper (Carton et al., IV 2021): its tables I and II."""

from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from wrongturn_protocol import PAPER_TYPES, Condition, FaultKind, JunctionType


@dataclass(frozen=True)
class PaperAgent:
    """One of the paper's five agents."""

    title: str
    ours: str | None
    """The agent here that is made like it; None where there is none."""
    success: tuple[int, int, int, int]
    """Table I: navigation routes completed, percent, in the order of :class:`~wrongturn_protocol.Condition`."""
    infeasible: tuple[int, int, int]
    """Table II: unsafe of ten with the wrong command, in the order of ``PAPER_TYPES``."""
    omission: tuple[int, int, int]
    """Table II: unsafe of ten with the command to follow the lane."""

    @property
    def unsafe(self) -> int:
        """Of all sixty."""
        return sum(self.infeasible) + sum(self.omission)

    def cell(self, kind: JunctionType, fault: FaultKind) -> int:
        """Unsafe of ten."""
        row = self.infeasible if fault is FaultKind.INFEASIBLE else self.omission
        return row[PAPER_TYPES.index(kind)]

    def succeeded(self, condition: Condition) -> int:
        """Navigation routes completed, percent."""
        return self.success[list(Condition).index(condition)]


PAPER: Final = (
    PaperAgent("Learning by Cheating", None, (100, 100, 98, 100), (0, 5, 10), (0, 0, 8)),
    PaperAgent("MaRLn", None, (100, 100, 100, 98), (2, 1, 10), (0, 0, 0)),
    PaperAgent("RL, segmentation as input", "ppo-segmentation", (100, 100, 100, 100), (0, 10, 9), (0, 6, 10)),
    PaperAgent("RL, image as input", "ppo-image", (82, 98, 49, 40), (0, 1, 7), (0, 4, 4)),
    PaperAgent("RL, image with auxiliary task", "ppo-auxiliary", (90, 92, 78, 68), (0, 2, 0), (1, 0, 0)),
)
"""In the order of its tables."""

ALGORITHMS: Final = tuple(agent.ours for agent in PAPER if agent.ours is not None)
"""The agents here that are made like the paper's own, from its most unsafe to its least."""

LIKE: Final = MappingProxyType({agent.ours: agent for agent in PAPER if agent.ours is not None})
"""The paper's agents by the name of ours."""
