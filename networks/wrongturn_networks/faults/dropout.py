"""Dropout: there is no command for a part of the way."""

from wrongturn_networks.faults.fault import AFTER, SILENCE, CommandFault, Dose, Ending, Guidance, reaction_to_silence
from wrongturn_protocol import Command, FaultKind, Reaction, Trial


class Dropout(CommandFault):
    """VOID in the first part of the command's window; then the route's command."""

    kind = FaultKind.DROPOUT
    guide_word = "less"
    words = "The command is lost when the junction comes near, and is right again after a part of the way."
    end = "after the dose's share of the window's way"
    dose = Dose("the share of the window's way on which there is no command", "", 0.1, 1.0, 0.5, (0.25, 0.5, 1.0))
    reactions = SILENCE

    def deliver(self, t: float, guidance: Guidance) -> Command:  # noqa: ARG002
        """Return VOID in the first part of a window."""
        here = guidance.within()
        if here is None:
            return guidance.command
        whole = guidance.window + (here.to_exit - here.to_line) + AFTER
        return Command.VOID if guidance.window - here.to_line <= self.amount * whole else guidance.command

    @classmethod
    def reaction(cls, trial: Trial, ending: Ending) -> Reaction:  # noqa: ARG003
        """Return whether the car took an exit, or stopped."""
        return reaction_to_silence(ending)
