"""Flicker: the command alternates between right and wrong."""

from wrongturn_faults.rules import DOSES, missing_or_other
from wrongturn_networks.faults.fault import Dose, WrongDirection
from wrongturn_protocol import Command, FaultKind, Outcome, Trial


class Flicker(WrongDirection):
    """The route's command and a wrong one in turn, within the command's window."""

    kind = FaultKind.FLICKER
    guide_word = "part of"
    words = "The command alternates between the right direction and a wrong one."
    drawn = "where in its period it begins; at a crossing, which exit is the wrong one"
    dose = Dose("the share of the time in which it is wrong", "", 0.1, 0.9, DOSES["flicker"], (0.25, 0.5, 0.75))
    period = Dose("the time after which it repeats itself", "s", 0.2, 2.0, 1.0, (1.0,))

    @classmethod
    def wrong(cls, trial: Trial) -> Command:
        """Return the missing direction; at a crossing, another exit."""
        return missing_or_other(trial.route, trial.junction_type.exits, trial.seed)

    @classmethod
    def complied(cls, trial: Trial, outcome: Outcome) -> bool:
        """Return whether the car took one of the two exits that were commanded."""
        return outcome.verdict.exited and outcome.exit in {trial.route, cls.wrong(trial)}
