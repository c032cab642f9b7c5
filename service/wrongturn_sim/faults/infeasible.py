"""Infeasible, the paper's first fault: a direction in which the junction has no exit."""

from wrongturn_protocol import Command, FaultKind, Trial
from wrongturn_sim.faults.fault import CommandFault, Guidance


class Infeasible(CommandFault):
    """The one direction that the approach lacks, within the command's window."""

    kind = FaultKind.INFEASIBLE

    @classmethod
    def refusal(cls, trial: Trial) -> str | None:
        """Refuse approaches that have all three directions."""
        if trial.junction_type.missing is not None:
            return None
        return (
            f"needs an approach that lacks a direction, but {trial.approach} of {trial.town} has all three; "
            "take another approach or another fault"
        )

    def deliver(self, t: float, guidance: Guidance) -> Command:  # noqa: ARG002
        """Return the missing direction within a window; at later junctions that lack none, the route's command."""
        if guidance.command is Command.LANE_FOLLOW or guidance.approach is None:
            return guidance.command
        return guidance.approach.type.missing or guidance.command
