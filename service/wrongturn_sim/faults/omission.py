"""Omission, the paper's second fault: no junction is ever announced."""

from wrongturn_protocol import Command, FaultKind
from wrongturn_sim.faults.fault import CommandFault
from wrongturn_sim.route import Guidance


class Omission(CommandFault):
    """LANE_FOLLOW throughout."""

    kind = FaultKind.OMISSION

    def deliver(self, t: float, guidance: Guidance) -> Command:  # noqa: ARG002
        """LANE_FOLLOW."""
        return Command.LANE_FOLLOW
