"""What every fault is."""

from abc import ABC, abstractmethod
from typing import ClassVar

from wrongturn_networks import FaultNotApplicableError
from wrongturn_protocol import Command, FaultKind, Trial
from wrongturn_sim.route import Guidance

__all__ = ["CommandFault", "FaultNotApplicableError"]


class CommandFault(ABC):
    """Turns the route's command into the one that is delivered; made anew for each episode.

    A fault that draws takes its numbers from the trial's seed alone.
    """

    kind: ClassVar[FaultKind]

    def __init__(self, trial: Trial) -> None:
        """Prepare for one episode; FaultNotApplicableError where the trial's approach does not admit the fault."""
        self.trial = trial

    @abstractmethod
    def deliver(self, t: float, guidance: Guidance) -> Command:
        """The command for the coming 0.1 s.

        Args:
            t: seconds since the episode's start.
            guidance: what the route says.
        """
