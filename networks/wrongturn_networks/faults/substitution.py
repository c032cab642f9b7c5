"""Substitution: another exit than the route's."""

from wrongturn_networks.faults.fault import Guidance, WrongDirection, other_exit
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

    def deliver(self, t: float, guidance: Guidance) -> Command:  # noqa: ARG002
        """Return the other exit within a window."""
        here = guidance.within()
        return guidance.command if here is None else other_exit(here.route, here.exits, self.seed)
