"""No fault: what a trial's twin has."""

from wrongturn_protocol import Command, FaultKind
from wrongturn_sim.faults.fault import CommandFault, Guidance


class NoFault(CommandFault):
    """The route's command, unchanged."""

    kind = FaultKind.NONE

    def deliver(self, t: float, guidance: Guidance) -> Command:  # noqa: ARG002
        """Return the route's command."""
        return guidance.command
