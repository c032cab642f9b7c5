"""Omission, the paper's second fault: no junction is announced."""

from collections.abc import Callable

from wrongturn_networks.faults.fault import SILENCE, CommandFault, Ending, reaction_to_silence
from wrongturn_protocol import Command, FaultKind, Reaction, Trial


class Omission(CommandFault):
    """LANE_FOLLOW all the time."""

    kind = FaultKind.OMISSION
    guide_word = "no"
    words = "No turn is announced: the command says to follow the lane all the time."
    onset = "at the start"
    end = "at the end"
    reactions = SILENCE

    @classmethod
    def reaction(cls, trial: Trial, ending: Ending) -> Reaction:  # noqa: ARG003
        """Return whether the car took an exit, or stopped."""
        return reaction_to_silence(ending)

    @classmethod
    def told(cls, trial: Trial, names: Callable[[Command], str]) -> str:
        """Say that nothing was announced."""
        return f"The command never announced the junction. The route goes {names(trial.route)}."
