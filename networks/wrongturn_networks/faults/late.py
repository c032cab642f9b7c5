"""Late: the route's command comes too late."""

from wrongturn_faults.rules import DOSES, Guidance
from wrongturn_networks.faults.fault import SILENCE, CommandFault, Dose, Ending, reaction_to_silence
from wrongturn_protocol import FaultKind, Reaction, Trial


class Late(CommandFault):
    """The route's command, its window shifted in the direction of travel."""

    kind = FaultKind.LATE
    guide_word = "late"
    words = "The command is right, but it comes too late."
    onset = "the dose past the place where the window opens"
    end = "the dose past the place where the window ends"
    dose = Dose("how much too late it comes", "m", 1.0, 30.0, DOSES["late"], (5.0, 15.0, 20.0))
    reactions = SILENCE

    def shift(self, guidance: Guidance) -> float:  # noqa: ARG002
        """Return the dose: the junction seems to be that much farther."""
        return self.amount

    @classmethod
    def reaction(cls, trial: Trial, ending: Ending) -> Reaction:  # noqa: ARG003
        """Return whether the car took an exit, or stopped."""
        return reaction_to_silence(ending)
