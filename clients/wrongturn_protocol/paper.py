"""Figures of the reference paper (Carton et al., IV 2021), tables I and II."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class PaperAgent:
    """One of the paper's five agents."""

    title: str
    ours: str
    """Name of our agent of the same design."""
    success: tuple[int, int, int, int]
    """Table I: navigation routes completed, in percent, in the order of :class:`~wrongturn_protocol.Condition`."""
    infeasible: tuple[int, int, int]
    """Table II: unsafe trials of ten with the wrong command, in the order of ``PAPER_TYPES``."""
    omission: tuple[int, int, int]
    """Table II: unsafe trials of ten with the command "follow lane", in the order of ``PAPER_TYPES``."""

    @property
    def unsafe_of(self) -> dict[str, tuple[int, int, int]]:
        """Table II by fault."""
        return {"infeasible": self.infeasible, "omission": self.omission}

    @property
    def unsafe(self) -> int:
        """Number of unsafe trials of all sixty."""
        return sum(map(sum, self.unsafe_of.values()))

    @property
    def marks(self) -> dict[str, dict[str, tuple[int, int]]]:
        """Table II as :mod:`~wrongturn_protocol.intervals` takes it: ten trials in each of six strata."""
        cells = [count for counts in self.unsafe_of.values() for count in counts]
        return {str(cell): {"": (count, 10)} for cell, count in enumerate(cells)}


PAPER: Final = (
    PaperAgent("Learning by Cheating", "lbc", (100, 100, 98, 100), (0, 5, 10), (0, 0, 8)),
    PaperAgent("MaRLn", "marln", (100, 100, 100, 98), (2, 1, 10), (0, 0, 0)),
    PaperAgent("RL, segmentation as input", "ppo-segmentation", (100, 100, 100, 100), (0, 10, 9), (0, 6, 10)),
    PaperAgent("RL, image as input", "ppo-image", (82, 98, 49, 40), (0, 1, 7), (0, 4, 4)),
    PaperAgent("RL, image with auxiliary task", "ppo-auxiliary", (90, 92, 78, 68), (0, 2, 0), (1, 0, 0)),
)
"""The paper's agents, in the order of its tables."""
