"""Base class of all faults, and what the route tells them."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, NamedTuple

from wrongturn_networks.junctions import Approach
from wrongturn_protocol import Command, FaultKind, Reaction, Trial, Verdict


class Guidance(NamedTuple):
    """What the route planner says at one decision."""

    command: Command
    """The route's command: a direction within the window, LANE_FOLLOW elsewhere."""
    approach: Approach | None
    """The approach whose window this is; outside a window the one ahead, or None."""
    travelled: float
    """Metres along the route since the window opened; negative before it, inf with no junction ahead.
    Inside a junction it is measured along the route's path."""
    lateral: float
    """Distance of the body's centre from the route's path, metres, positive to the left."""
    heading: float
    """Heading of the route's path there, radians."""


class CommandFault(ABC):
    """Turns the route's command into the one that the agent gets.

    Each episode has a new object. A fault that draws numbers takes them from the trial's seed alone.

    ``trial`` is the one that is driven; :meth:`refusal` has accepted it.
    """

    kind: ClassVar[FaultKind]
    guide_word: ClassVar[str]
    """Guide word of IEC 61882."""
    words: ClassVar[str]
    """What it does to the command, as a sentence for pages."""
    reactions: ClassVar[tuple[Reaction, ...]] = ()
    """Reactions that metrics count, even where none was seen; empty for a fault without reactions of its own."""

    def __init__(self, trial: Trial) -> None:
        self.trial = trial

    @classmethod
    def refusal(cls, trial: Trial) -> str | None:  # noqa: ARG003
        """Return why the fault cannot be applied to a trial, and the remedy; None where it can.

        The text continues a sentence that begins with the fault's name: "needs an approach that …; take another".
        """
        return None

    @abstractmethod
    def deliver(self, t: float, guidance: Guidance) -> Command:
        """Return the command that the agent gets for the next 0.1 s, ``t`` seconds after the episode's start."""

    @classmethod
    def reaction(cls, verdict: Verdict, on_missing_side: Callable[[], bool]) -> Reaction | None:  # noqa: ARG003
        """Return the agent's reaction at the verdict, one of :attr:`reactions`; None for a fault without any.

        Args:
            verdict: how the episode ended.
            on_missing_side: says whether the car is where the approach's missing arm would be, or on the way there.
        """
        return None

    @classmethod
    def told(cls, trial: Trial, names: Callable[[Command], str]) -> str:
        """Return what the agent was told at the junction, as sentences; ``names`` gives the word for a command."""
        return f"{cls.words} The route goes {names(trial.route)}."
