"""Infeasible, the paper's first fault: a direction in which the junction has no exit."""

from collections.abc import Callable

from wrongturn_networks.faults.fault import WrongDirection
from wrongturn_protocol import Command, FaultKind, Trial


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

    @classmethod
    def told(cls, trial: Trial, names: Callable[[Command], str]) -> str:
        """Name the missing direction."""
        missing = trial.junction_type.missing
        if missing is None:
            return super().told(trial, names)
        return f"The command said {names(missing)}, where there is no exit. The route goes {names(trial.route)}."
