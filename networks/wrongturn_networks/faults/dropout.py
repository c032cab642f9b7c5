"""Dropout: there is no command for a part of the way."""

from wrongturn_faults.rules import DOSES
from wrongturn_networks.faults.fault import SILENCE, CommandFault, Dose, Ending, reaction_to_silence
from wrongturn_protocol import FaultKind, Reaction, Trial


class Dropout(CommandFault):
    """VOID in the first part of the command's window; then the route's command."""

    kind = FaultKind.DROPOUT
    guide_word = "less"
    words = "The command is lost when the junction comes near, and is right again after a part of the way."
    end = "after the dose's share of the window's way"
    dose = Dose(
        "the share of the window's way on which there is no command", "", 0.1, 1.0, DOSES["dropout"], (0.25, 0.5, 1.0)
    )
    reactions = SILENCE

    @classmethod
    def reaction(cls, trial: Trial, ending: Ending) -> Reaction:  # noqa: ARG003
        """Return whether the car took an exit, or stopped."""
        return reaction_to_silence(ending)
