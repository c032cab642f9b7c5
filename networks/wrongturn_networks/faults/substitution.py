"""Substitution: another exit than the route's."""

from wrongturn_faults.rules import other_exit
from wrongturn_networks.faults.fault import WrongDirection
from wrongturn_protocol import Command, FaultKind, Trial


class Substitution(WrongDirection):
    """Another exit that exists, within the command's window."""

    kind = FaultKind.SUBSTITUTION
    guide_word = "other than"
    words = "The command names an exit that exists, but is not the route's."
    drawn = "which exit, of two at a crossing"

    @classmethod
    def wrong(cls, trial: Trial) -> Command:
        """Return the other exit."""
        return other_exit(trial.route, trial.junction_type.exits, trial.seed)
