"""Stuck: one command for the whole drive."""

from wrongturn_faults.rules import not_the_route
from wrongturn_networks.faults.fault import WrongDirection
from wrongturn_protocol import Command, FaultKind, Trial


class Stuck(WrongDirection):
    """One direction, not the route's, from the start to the end."""

    kind = FaultKind.STUCK
    guide_word = "more"
    words = "The command names the same direction all the time, and it is not the route's."
    onset = "at the start"
    end = "at the end"
    drawn = "which direction, of two; it may have no exit"

    @classmethod
    def wrong(cls, trial: Trial) -> Command:
        """Return the direction."""
        return not_the_route(trial.route, trial.seed)
