"""Infeasible, the paper's first fault: a direction in which the junction has no exit."""

from collections.abc import Callable

from wrongturn_networks.faults.fault import Guidance, WrongDirection
from wrongturn_protocol import DIRECTIONS, Command, FaultKind, Trial


class Infeasible(WrongDirection):
    """The one direction that the approach lacks, within the command's window."""

    kind = FaultKind.INFEASIBLE
    guide_word = "other than"
    words = "The command names the one direction in which the junction has no exit."

    @classmethod
    def refusal(cls, trial: Trial) -> str | None:
        """Refuse approaches that have all three directions."""
        if trial.junction_type.missing is not None:
            return None
        return (
            f"needs an approach that lacks a direction, but {trial.approach} of {trial.town} has all three; "
            "take another approach or another fault"
        )

    @classmethod
    def wrong(cls, trial: Trial) -> Command:
        """Return the missing direction."""
        return trial.junction_type.missing or trial.route

    def deliver(self, t: float, guidance: Guidance) -> Command:  # noqa: ARG002
        """Return the missing direction within a window; at later junctions that lack none, the route's command."""
        here = guidance.within()
        if here is None:
            return guidance.command
        return next(iter(frozenset(DIRECTIONS) - here.exits), guidance.command)

    @classmethod
    def told(cls, trial: Trial, names: Callable[[Command], str]) -> str:
        """Name the missing direction."""
        missing = trial.junction_type.missing
        if missing is None:
            return super().told(trial, names)
        return f"The command said {names(missing)}, where there is no exit. The route goes {names(trial.route)}."
