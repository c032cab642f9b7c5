"""Commission: a turn is announced where nothing branches off."""

from typing import Final

from wrongturn_faults.rules import ENDS, LENGTH, Guidance
from wrongturn_networks.faults.fault import CommandFault, Ending
from wrongturn_protocol import Fault, FaultKind, Reaction, Trial, Verdict

_LEAD: Final = 2.0  # a start lies this far before the stretch at least, metres


class Commission(CommandFault):
    """A turn that is not the route's, in a stretch of the lane before the junction; then the command as usual."""

    kind = FaultKind.COMMISSION
    guide_word = "as well as"
    words = "The command names a turn on the way to the junction, where nothing branches off."
    onset = f"{ENDS + LENGTH:g} m before the stop line"
    end = f"{ENDS:g} m before the stop line"
    drawn = "left or right, where the route goes straight on; else it is the other one"
    reactions = (Reaction.OBEYED, Reaction.EXIT, Reaction.FROZE, Reaction.OTHER)

    @classmethod
    def room(cls, fault: Fault) -> float:  # noqa: ARG003
        """Return a distance before the stretch."""
        return ENDS + LENGTH + _LEAD

    @classmethod
    def refusal(cls, trial: Trial) -> str | None:
        """Refuse starts that do not lie before the stretch."""
        least = ENDS + LENGTH
        if trial.start.distance > least:
            return None
        return (
            f"needs a start more than {least:.0f} m before the stop line, but {trial.approach} of {trial.town} "
            f"has it at {trial.start.distance:.0f} m; take an approach whose lane is longer"
        )

    def shift(self, guidance: Guidance) -> float:
        """Return the distance to the junction that is not there, at the end of the stretch."""
        there = guidance.ahead is not None and guidance.ahead.first and guidance.ahead.to_line >= ENDS
        return -ENDS if there else 0.0

    @classmethod
    def reaction(cls, trial: Trial, ending: Ending) -> Reaction:  # noqa: ARG003
        """Return OBEYED for a car that came to grief, FROZE for one that stopped, both before it was engaged."""
        if not ending.engaged:
            if ending.crashed:
                return Reaction.OBEYED
            return Reaction.FROZE if ending.verdict is Verdict.NOT_ENGAGED else Reaction.OTHER
        return Reaction.EXIT if ending.verdict.exited else Reaction.OTHER
