"""Omission, the paper's second fault: no junction is announced."""

from wrongturn_protocol import Command, FaultKind
from wrongturn_sim.faults.fault import CommandFault, Guidance


class Omission(CommandFault):
    """LANE_FOLLOW all the time."""

    kind = FaultKind.OMISSION

    def deliver(self, t: float, guidance: Guidance) -> Command:  # noqa: ARG002
        """Return LANE_FOLLOW."""
        return Command.LANE_FOLLOW
