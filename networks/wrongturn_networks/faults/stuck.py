"""Stuck: one command for the whole drive."""

from wrongturn_faults.rules import pick
from wrongturn_networks.faults.fault import WrongDirection
from wrongturn_protocol import DIRECTIONS, Command, FaultKind, Trial


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
        return pick(frozenset(DIRECTIONS) - {trial.route}, trial.seed)
