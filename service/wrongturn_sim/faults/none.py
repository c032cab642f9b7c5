"""No fault: a trial's twin."""

from wrongturn_protocol import Command, FaultKind
from wrongturn_sim.faults.fault import CommandFault
from wrongturn_sim.route import Guidance


class NoFault(CommandFault):
    """The route's command."""

    kind = FaultKind.NONE

    def deliver(self, t: float, guidance: Guidance) -> Command:  # noqa: ARG002
        """The route's command."""
        return guidance.command
