"""Omission, the paper's second fault: no junction is announced."""

from collections.abc import Callable

from wrongturn_networks.faults.fault import CommandFault, Guidance
from wrongturn_protocol import Command, FaultKind, Reaction, Trial, Verdict


class Omission(CommandFault):
    """LANE_FOLLOW all the time."""

    kind = FaultKind.OMISSION
    guide_word = "no"
    words = "No turn is announced: the command says to follow the lane all the time."
    reactions = (Reaction.EXIT, Reaction.FROZE, Reaction.OTHER)

    def deliver(self, t: float, guidance: Guidance) -> Command:  # noqa: ARG002
        """Return LANE_FOLLOW."""
        return Command.LANE_FOLLOW

    @classmethod
    def reaction(cls, verdict: Verdict, on_missing_side: Callable[[], bool]) -> Reaction | None:  # noqa: ARG003
        """Return whether the car took an exit, or stopped."""
        if verdict.stopped:
            return Reaction.FROZE
        return Reaction.EXIT if verdict.exited else Reaction.OTHER

    @classmethod
    def told(cls, trial: Trial, names: Callable[[Command], str]) -> str:
        """Say that nothing was announced."""
        return f"The command never announced the junction. The route goes {names(trial.route)}."
