"""Infeasible, the paper's first fault: a direction in which the junction has no exit."""

from collections.abc import Callable

from wrongturn_networks.faults.fault import CommandFault, Guidance
from wrongturn_protocol import Command, FaultKind, Reaction, Trial, Verdict


class Infeasible(CommandFault):
    """The one direction that the approach lacks, within the command's window."""

    kind = FaultKind.INFEASIBLE
    guide_word = "other than"
    words = "The command names the one direction in which the junction has no exit."
    reactions = (Reaction.OBEYED, Reaction.OVERRODE, Reaction.FROZE, Reaction.OTHER)

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

    @classmethod
    def reaction(cls, verdict: Verdict, on_missing_side: Callable[[], bool]) -> Reaction | None:
        """Return OBEYED for a car that crashed or left the road on the side of the missing arm."""
        if verdict.stopped:
            return Reaction.FROZE
        if verdict.exited:
            return Reaction.OVERRODE
        crashed = verdict in {Verdict.COLLISION, Verdict.OFF_ROAD}
        return Reaction.OBEYED if crashed and on_missing_side() else Reaction.OTHER

    @classmethod
    def told(cls, trial: Trial, names: Callable[[Command], str]) -> str:
        """Name the missing direction."""
        missing = trial.junction_type.missing
        if missing is None:
            return super().told(trial, names)
        return f"The command said {names(missing)}, where there is no exit. The route goes {names(trial.route)}."
