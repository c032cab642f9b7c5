"""Prohibited: an exit whose street is closed by boards."""

from wrongturn_faults.rules import other_exit
from wrongturn_networks.faults.fault import WrongDirection
from wrongturn_protocol import Command, FaultKind, Trial


class Prohibited(WrongDirection):
    """An exit that boards close right at its mouth, within the command's window of the trial's junction."""

    kind = FaultKind.PROHIBITED
    guide_word = "other than"
    words = "The command names a street that is closed by boards at its mouth."
    drawn = "which street, of two at a crossing"

    @classmethod
    def wrong(cls, trial: Trial) -> Command:
        """Return the closed direction."""
        return other_exit(trial.route, trial.junction_type.exits, trial.seed)

    @classmethod
    def closed(cls, trial: Trial) -> Command:
        """Return the closed direction."""
        return cls.wrong(trial)

    @classmethod
    def detectable(cls, trial: Trial) -> bool:  # noqa: ARG003
        """Return True: the boards can be seen."""
        return True
