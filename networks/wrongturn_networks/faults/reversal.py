"""Reversal: the command changes to a wrong one within the junction."""

from wrongturn_faults.rules import DOSES, not_the_route
from wrongturn_networks.faults.fault import Dose, WrongDirection
from wrongturn_protocol import Command, FaultKind, Trial


class Reversal(WrongDirection):
    """The route's command until the car is in the junction; then another direction until the window ends."""

    kind = FaultKind.REVERSAL
    guide_word = "reverse"
    words = "The command is right until the car is in the junction, and then names another direction."
    onset = "the dose past the stop line"
    drawn = "which direction, of two; it may have no exit"
    dose = Dose(
        "how far past the stop line it changes",
        "m",
        0.0,
        15.0,
        DOSES["reversal"],
        (2.0, 5.0, 10.0),
        more_is_worse=False,
    )

    @classmethod
    def wrong(cls, trial: Trial) -> Command:
        """Return the other direction."""
        return not_the_route(trial.route, trial.seed)
