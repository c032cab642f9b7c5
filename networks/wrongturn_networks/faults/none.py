"""No fault: what a trial's twin has."""

from collections.abc import Callable

from wrongturn_networks.faults.fault import CommandFault
from wrongturn_protocol import Command, FaultKind, Trial


class NoFault(CommandFault):
    """The route's command, unchanged."""

    kind = FaultKind.NONE
    guide_word = ""
    words = "The command is right. These are the twins, which show how well the agent drives at all."

    @classmethod
    def told(cls, trial: Trial, names: Callable[[Command], str]) -> str:
        """Say that the command is right."""
        return f"The command said {names(trial.route)}, which is right."
