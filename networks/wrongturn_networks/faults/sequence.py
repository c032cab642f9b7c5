"""Sequence: the command of the next junction comes one junction too soon."""

from wrongturn_faults.rules import pick
from wrongturn_networks.faults.fault import WrongDirection
from wrongturn_protocol import Command, FaultKind, Trial


class Sequence(WrongDirection):
    """The command of the junction after this one, within this one's window."""

    kind = FaultKind.SEQUENCE
    guide_word = "before, after"
    words = "The command is that of the junction after this one."
    drawn = "the route's direction there"

    @classmethod
    def fitted(cls, trial: Trial, onward: frozenset[Command]) -> Trial:
        """Let the route take another direction at the next junction than at this one."""
        others = onward - {trial.route}
        return trial.model_copy(update={"next_route": pick(others, trial.seed)}) if others else trial

    @classmethod
    def refusal(cls, trial: Trial) -> str | None:
        """Refuse trials that do not say how the route goes on, or that it goes on the same way."""
        if trial.next_route not in {None, trial.route}:
            return None
        return (
            f"needs a route that takes another direction at the next junction, and this one from {trial.approach} of "
            f"{trial.town} has next_route {trial.next_route and trial.next_route.name}; draw the trial, "
            "at an approach whose exits lead to other junctions"
        )

    @classmethod
    def wrong(cls, trial: Trial) -> Command:
        """Return the direction at the next junction."""
        return trial.next_route or trial.route
