"""Contradiction: the planner's words disagree."""

from wrongturn_faults.rules import Guidance, missing_or_other
from wrongturn_networks.faults.fault import WrongDirection
from wrongturn_protocol import Command, FaultKind, Trial


class Contradiction(WrongDirection):
    """The command stays right; distance, target points and sentences follow a wrong direction within the window.

    Where an agent gets sentences alone, the sentence says both, the right direction first. An agent that gets nothing
    but the command notices nothing.
    """

    kind = FaultKind.CONTRADICTION
    guide_word = "as well as"
    words = "The command is right, but what the planner says beside it names another direction."
    drawn = "which other exit, where the junction has all three"

    @classmethod
    def wrong(cls, trial: Trial) -> Command:
        """Return the missing direction or, where there is none, another exit."""
        return missing_or_other(trial.route, trial.junction_type.exits, trial.seed)

    def beside(self, t: float, guidance: Guidance) -> Command:
        """Return the wrong direction within the window."""
        here = guidance.within()
        return self.deliver(t, guidance) if here is None else missing_or_other(here.route, here.exits, self.seed)
