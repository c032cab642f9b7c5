"""Corrected: a wrong command that is put right before the junction."""

from wrongturn_faults.rules import DOSES, OPENS
from wrongturn_networks.faults.fault import Dose, WrongDirection
from wrongturn_protocol import Command, FaultKind, Trial


class Corrected(WrongDirection):
    """The direction that the approach lacks; then, shortly before the stop line or past it, the route's."""

    kind = FaultKind.CORRECTED
    guide_word = "early, late"
    words = "The command first names the direction in which the junction has no exit, and is then put right."
    end = "the dose before the stop line"
    dose = Dose(
        "how far before the stop line it is put right",
        "m",
        -10.0,
        9.0,
        DOSES["corrected"],
        (8.0, 5.0, 0.0),
        more_is_worse=False,
    )

    @classmethod
    def refusal(cls, trial: Trial) -> str | None:
        """Refuse approaches that have all three directions, and doses that leave no wrong command."""
        if trial.junction_type.missing is None:
            return (
                f"needs an approach that lacks a direction, but {trial.approach} of {trial.town} has all three; "
                "take another approach or another fault"
            )
        opens, dose = OPENS if trial.window is None else trial.window, cls.amount_of(trial.fault)
        if dose < opens:
            return None
        return f"is put right {dose:g} m before the stop line, where the window opens; give a dose below {opens:g} m"

    @classmethod
    def wrong(cls, trial: Trial) -> Command:
        """Return the missing direction."""
        return trial.junction_type.missing or trial.route
