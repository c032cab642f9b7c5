"""Base classes of all faults, and what the route and the judge tell them."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, Final, NamedTuple

from wrongturn_faults.rules import RULES, Guidance, Order
from wrongturn_protocol import Command, Fault, FaultKind, Outcome, Reaction, Trial, Verdict


class Ending(NamedTuple):
    """How an episode ended."""

    verdict: Verdict
    exit: Command | None
    """Direction of the exit that was taken."""
    engaged: bool
    """Whether the car came near the junction."""
    on_side: Callable[[Command], bool]
    """Says whether the car is where an arm in a direction lies or would lie, or on the way there."""

    @property
    def crashed(self) -> bool:
        """Whether the car hit something or left the road."""
        return self.verdict in {Verdict.COLLISION, Verdict.OFF_ROAD}


class Dose(NamedTuple):
    """What a number of a fault means."""

    meaning: str
    """Of what it is the amount, for pages."""
    unit: str
    low: float
    high: float
    """The smallest and the largest that is taken."""
    usual: float
    """Taken where none is given."""
    suites: tuple[float, ...] = ()
    """Those that suites use."""
    more_is_worse: bool = True
    """Whether a larger one is harder for the agent."""

    def refusal(self, name: str, value: float | None) -> str | None:
        """Return why a value cannot be taken, and the remedy; None where it can."""
        if value is None or self.low <= value <= self.high:
            return None
        return f"fault.{name}: is {value:g}; give {self.meaning}, {self.low:g} to {self.high:g} {self.unit}".rstrip()


class CommandFault(ABC):
    """Turns the route's command into the one that the agent gets.

    Each episode has a new object. A fault that draws numbers takes them from the trial's seed alone, and
    :meth:`deliver` depends on nothing but its arguments, the trial's route and seed, dose and period.

    ``trial`` is the one that is driven; :meth:`refusal` has accepted it.
    """

    kind: ClassVar[FaultKind]
    guide_word: ClassVar[str]
    """Guide word of IEC 61882."""
    words: ClassVar[str]
    """What it does to the command, as a sentence for pages."""
    onset: ClassVar[str] = "where the window opens"
    """Where it begins, for pages."""
    end: ClassVar[str] = "where the window ends"
    """Where it ends, for pages."""
    drawn: ClassVar[str] = "nothing"
    """What the seed decides, for pages."""
    dose: ClassVar[Dose | None] = None
    """How strong it is; None for a fault that cannot be stronger or weaker."""
    period: ClassVar[Dose | None] = None
    """After what time it repeats itself; None for a fault that does not."""
    reactions: ClassVar[tuple[Reaction, ...]] = ()
    """Reactions that metrics count, even where none was seen; empty for a fault without reactions of its own."""

    def __init__(self, trial: Trial) -> None:
        self.trial = trial
        self.route, self.seed = trial.route, trial.seed
        self.amount = self.amount_of(trial.fault)
        """The dose: the trial's, or the usual one; 0 for a fault without."""
        self.every = self._given(self.period, trial.fault.period)
        """The period, likewise, seconds."""
        self._order = Order(self.route, trial.junction_type.exits, self.seed, self.amount, self.every, trial.next_route)
        # A fault of another package delivers by its own method.
        self._rule = RULES.get(self.kind, RULES["none"])

    @classmethod
    def amount_of(cls, fault: Fault) -> float:
        """Return the dose that is given, or the usual one; 0 for a fault without."""
        return cls._given(cls.dose, fault.dose)

    @staticmethod
    def _given(dose: Dose | None, value: float | None) -> float:
        return (0.0 if dose is None else dose.usual) if value is None else value

    @classmethod
    def refusal(cls, trial: Trial) -> str | None:  # noqa: ARG003
        """Return why the fault cannot be applied to a trial, and the remedy; None where it can.

        The text continues a sentence that begins with the fault's name: "needs an approach that …; take another".
        The numbers of the trial's fault are in their ranges.
        """
        return None

    @classmethod
    def room(cls, fault: Fault) -> float:  # noqa: ARG003
        """Return how far before the stop line a start has to lie at least, metres; 0 for one as usual."""
        return 0.0

    @classmethod
    def fitted(cls, trial: Trial, onward: frozenset[Command]) -> Trial:  # noqa: ARG003
        """Return a newly drawn trial with what the fault needs besides.

        ``onward`` are the exits at the next junction of the route; empty where none comes.
        """
        return trial

    @classmethod
    def closed(cls, trial: Trial) -> Command | None:  # noqa: ARG003
        """Return the exit whose street is closed by boards; None for none."""
        return None

    @classmethod
    def detectable(cls, trial: Trial) -> bool:  # noqa: ARG003
        """Return whether the driver could see from the road that the command is wrong.

        Where nobody could, metrics also count whether the agent complied.
        """
        return True

    @classmethod
    def complied(cls, trial: Trial, outcome: Outcome) -> bool:  # noqa: ARG003
        """Return whether the car took the exit that was commanded."""
        return outcome.verdict is Verdict.EXIT_COMMANDED

    def deliver(self, t: float, guidance: Guidance) -> Command:
        """Return the command that the agent gets for the next 0.1 s, ``t`` seconds after the episode's start."""
        return self._rule(t, guidance, self._order)

    def beside(self, t: float, guidance: Guidance) -> Command:
        """Return the command that the planner's other words follow: distances, target points and sentences."""
        return self.deliver(t, guidance)

    def shift(self, guidance: Guidance) -> float:  # noqa: ARG002
        """Return how much farther the planner believes the junction ahead to be than it is, metres."""
        return 0.0

    @classmethod
    def reaction(cls, trial: Trial, ending: Ending) -> Reaction | None:  # noqa: ARG003
        """Return the agent's reaction at the verdict, one of :attr:`reactions`; None for a fault without any."""
        return None

    @classmethod
    def told(cls, trial: Trial, names: Callable[[Command], str]) -> str:
        """Return what the agent was told at the junction, as sentences; ``names`` gives the word for a command."""
        return f"{cls.words}{cls.measured(trial.fault)} The route goes {names(trial.route)}."

    @classmethod
    def measured(cls, fault: Fault) -> str:
        """Return dose and period as sentences, each after a space, such as "How much too late it comes: 15 m."."""
        found = ""
        for dose, value in ((cls.dose, fault.dose), (cls.period, fault.period)):
            if dose is not None:
                amount = f"{cls._given(dose, value):g} {dose.unit}".rstrip()
                found += f" {dose.meaning[0].upper()}{dose.meaning[1:]}: {amount}."
        return found


class WrongDirection(CommandFault):
    """A fault that names a direction which is not the route's: one without an exit, or another exit."""

    reactions = (Reaction.OBEYED, Reaction.OVERRODE, Reaction.FROZE, Reaction.OTHER)

    @classmethod
    @abstractmethod
    def wrong(cls, trial: Trial) -> Command:
        """Return the wrong direction at the trial's junction."""

    @classmethod
    def detectable(cls, trial: Trial) -> bool:
        """Return whether there is no exit in the wrong direction."""
        return cls.wrong(trial) not in trial.junction_type.exits

    @classmethod
    def reaction(cls, trial: Trial, ending: Ending) -> Reaction:
        """Return OBEYED for a car that took the wrong exit, or came to grief on the side of one that is none."""
        wrong = cls.wrong(trial)
        if ending.verdict.stopped:
            return Reaction.FROZE
        if ending.verdict.exited:
            return Reaction.OBEYED if ending.exit is wrong else Reaction.OVERRODE
        obeyed = ending.crashed and cls.detectable(trial) and ending.on_side(wrong)
        return Reaction.OBEYED if obeyed else Reaction.OTHER

    @classmethod
    def told(cls, trial: Trial, names: Callable[[Command], str]) -> str:
        """Name the wrong direction."""
        where = "" if cls.wrong(trial) in trial.junction_type.exits else ", where there is no exit"
        said = f"{cls.words}{cls.measured(trial.fault)} The wrong direction is {names(cls.wrong(trial))}{where}."
        return f"{said} The route goes {names(trial.route)}."


def reaction_to_silence(ending: Ending) -> Reaction:
    """Return whether the car took an exit, or stopped."""
    if ending.verdict.stopped:
        return Reaction.FROZE
    return Reaction.EXIT if ending.verdict.exited else Reaction.OTHER


SILENCE: Final = (Reaction.EXIT, Reaction.FROZE, Reaction.OTHER)
"""Reactions of :func:`reaction_to_silence`."""
