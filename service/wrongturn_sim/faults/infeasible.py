"""Infeasible, the paper's first fault: a direction in which the junction has no exit."""

from wrongturn_protocol import Command, FaultKind, Trial
from wrongturn_sim.faults.fault import CommandFault, FaultNotApplicableError
from wrongturn_sim.route import Guidance


class Infeasible(CommandFault):
    """Within the window, the one direction that the approach does not have."""

    kind = FaultKind.INFEASIBLE

    def __init__(self, trial: Trial) -> None:
        """FaultNotApplicableError at a junction that has all directions."""
        super().__init__(trial)
        if trial.junction_type.missing is None:
            raise FaultNotApplicableError(
                f"fault.kind: infeasible needs an approach that lacks a direction, {trial.approach} of {trial.town} "
                "has all three; take another approach or another fault",
            )

    def deliver(self, t: float, guidance: Guidance) -> Command:  # noqa: ARG002
        """The missing direction within the window; further on the way, crossings with all three get the route's."""
        if guidance.command is Command.LANE_FOLLOW or guidance.approach is None:
            return guidance.command
        return guidance.approach.type.missing or guidance.command
