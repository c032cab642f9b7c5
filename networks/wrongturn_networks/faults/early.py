"""Early: the route's command comes too soon, and ends too soon."""

from wrongturn_faults.rules import AFTER, DOSES, OPENS, Guidance
from wrongturn_networks.faults.fault import CommandFault, Dose, Ending
from wrongturn_networks.starts import WINDOW
from wrongturn_protocol import Fault, FaultKind, Reaction, Trial


class Early(CommandFault):
    """The route's command, its window shifted against the direction of travel."""

    kind = FaultKind.EARLY
    guide_word = "early"
    words = "The command is right, but it comes too early and ends too early."
    onset = "the dose before the window opens"
    end = "the dose before the window ends"
    dose = Dose("how much too early it comes", "m", 1.0, 60.0, DOSES["early"], (10.0, 20.0, 40.0))
    reactions = (Reaction.OBEYED, Reaction.EXIT, Reaction.FROZE, Reaction.OTHER)

    @classmethod
    def room(cls, fault: Fault) -> float:
        """Return a distance before the place at which the command begins."""
        return WINDOW[1] + cls.amount_of(fault) + 1.0

    @classmethod
    def refusal(cls, trial: Trial) -> str | None:
        """Refuse starts at which the command has begun already: its dose would be less than it says."""
        begins = (OPENS if trial.window is None else trial.window) + cls.amount_of(trial.fault)
        if trial.start.distance > begins:
            return None
        return (
            f"begins {begins:.0f} m before the stop line with this dose, and the car starts {trial.start.distance:.0f} "
            "m before it; give a smaller dose, or take an approach whose lane is longer"
        )

    def shift(self, guidance: Guidance) -> float:
        """Return minus the dose, until the junction seems to be passed."""
        ahead = guidance.ahead
        return 0.0 if ahead is None or ahead.to_line < self.amount - AFTER else -self.amount

    @classmethod
    def reaction(cls, trial: Trial, ending: Ending) -> Reaction:
        """Return OBEYED for a car that came to grief on the commanded side, or before it came near the junction."""
        if ending.verdict.exited:
            return Reaction.EXIT
        if ending.verdict.stopped:
            return Reaction.FROZE
        obeyed = ending.crashed and (not ending.engaged or ending.on_side(trial.route))
        return Reaction.OBEYED if obeyed else Reaction.OTHER
