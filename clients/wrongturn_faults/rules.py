"""What each fault delivers: pure functions of the junctions around the car, the trial's seed and the dose.

Metres along the route, seconds. The simulation of Wrongturn uses these functions; any other program can.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from wrongturn_faults.commands import DIRECTIONS, Command

AFTER = 5.0
"""The window ends this far past the exit line, metres."""
OPENS = 15.0
"""Where the window of a trial that sets none opens, metres before the stop line."""
LENGTH = 30.0
"""Length of commission's stretch, metres."""
ENDS = 40.0
"""Where commission's stretch ends, metres before the stop line."""
DECISIONS = 10
"""Decisions in a second."""


class Passage(NamedTuple):
    """A junction as the route leads through it."""

    route: Command
    """The route's direction there."""
    exits: frozenset[Command]
    """All directions in which a car that comes this way finds an exit."""
    to_line: float
    """Metres along the route to the stop line; negative past it."""
    to_exit: float
    """Metres along the route to the exit line; negative past it."""
    first: bool
    """Whether it is the trial's junction, the first on the way."""


class Guidance(NamedTuple):
    """What the route planner says at one decision.

    Apart from :attr:`lateral` and :attr:`heading`, which only the reward reads, this is all that faults may know.
    """

    command: Command
    """The route's command: a direction within the window, LANE_FOLLOW elsewhere."""
    window: float = OPENS
    """Where windows open, metres before stop lines."""
    ahead: Passage | None = None
    """The junction ahead, or around the car; None where none lies ahead."""
    last: Passage | None = None
    """The junction that the car left last; None before the first exit."""
    lateral: float = 0.0
    """Distance of the body's centre from the route's path, metres, positive to the left."""
    heading: float = 0.0
    """Heading of the route's path there, radians."""

    def within(self, shift: float = 0.0) -> Passage | None:
        """Return the junction in whose window the car is, if windows lie ``shift`` metres later; None outside."""
        for passage in (self.last, self.ahead):
            if passage is None or passage.to_line > self.window - shift:
                continue
            # A car that has taken no exit is in the window for as long as it is off its way.
            if passage.to_exit >= -AFTER - shift or (passage is self.ahead and shift >= 0.0):
                return passage
        return None


class Order(NamedTuple):
    """A fault as it is ordered for one drive. Doses and periods are in the units of ``docs/faults.md``."""

    route: Command
    """The route's direction at the first junction."""
    exits: frozenset[Command]
    """Directions of the first junction's exits."""
    seed: int = 0
    """Decides between two wrong directions."""
    dose: float = 0.0
    period: float = 1.0
    """Seconds; only ``flicker`` has one."""
    next_route: Command | None = None
    """The route's direction at the second junction, which ``sequence`` delivers at the first."""


def pick(directions: frozenset[Command], seed: int) -> Command:
    """Return one of some directions, the one that a seed decides."""
    found = sorted(directions)
    return found[seed % len(found)]


def other_exit(route: Command, exits: frozenset[Command], seed: int) -> Command:
    """Return an exit that is not the route's, of which there is one or more."""
    return pick(exits - {route}, seed)


def missing_or_other(route: Command, exits: frozenset[Command], seed: int) -> Command:
    """Return the direction in which there is no exit or, where there are all, an exit that is not the route's."""
    return pick(frozenset(DIRECTIONS) - exits or exits - {route}, seed)


def not_the_route(route: Command, seed: int) -> Command:
    """Return a direction that is not the route's; it may have no exit."""
    return pick(frozenset(DIRECTIONS) - {route}, seed)


def none(_t: float, guidance: Guidance, _order: Order) -> Command:
    """Return the route's command."""
    return guidance.command


def infeasible(_t: float, guidance: Guidance, _order: Order) -> Command:
    """Return the missing direction within a window; where none is missing, the route's command."""
    here = guidance.within()
    return guidance.command if here is None else next(iter(frozenset(DIRECTIONS) - here.exits), guidance.command)


def omission(_t: float, _guidance: Guidance, _order: Order) -> Command:
    """Return LANE_FOLLOW."""
    return Command.LANE_FOLLOW


def substitution(_t: float, guidance: Guidance, order: Order) -> Command:
    """Return another exit than the route's within a window."""
    here = guidance.within()
    return guidance.command if here is None else other_exit(here.route, here.exits, order.seed)


def prohibited(_t: float, guidance: Guidance, order: Order) -> Command:
    """Return the closed exit within the first junction's window."""
    here = guidance.within()
    first = here is not None and here.first
    return other_exit(order.route, order.exits, order.seed) if first else guidance.command


def commission(_t: float, guidance: Guidance, order: Order) -> Command:
    """Return a turn that is not the route's in a stretch before the first junction."""
    ahead = guidance.ahead
    there = ahead is not None and ahead.first and ENDS <= ahead.to_line <= ENDS + LENGTH
    return pick(frozenset({Command.LEFT, Command.RIGHT}) - {order.route}, order.seed) if there else guidance.command


def late(_t: float, guidance: Guidance, order: Order) -> Command:
    """Return the route's command in a window that lies the dose later."""
    here = guidance.within(order.dose)
    return Command.LANE_FOLLOW if here is None else here.route


def early(_t: float, guidance: Guidance, order: Order) -> Command:
    """Return the route's command in a window that lies the dose earlier."""
    here = guidance.within(-order.dose)
    return Command.LANE_FOLLOW if here is None else here.route


def stuck(_t: float, _guidance: Guidance, order: Order) -> Command:
    """Return one wrong direction from the start to the end."""
    return not_the_route(order.route, order.seed)


def sequence(_t: float, guidance: Guidance, order: Order) -> Command:
    """Return the second junction's direction within the first one's window."""
    here = guidance.within()
    return (order.next_route or order.route) if here is not None and here.first else guidance.command


def flicker(t: float, guidance: Guidance, order: Order) -> Command:
    """Return a wrong direction in a part of each period within a window."""
    here = guidance.within()
    if here is None:
        return guidance.command
    period = round(order.period * DECISIONS)
    wrong = min(max(round(order.dose * period), 1), period - 1)
    now = (round(t * DECISIONS) + order.seed) % period
    return missing_or_other(here.route, here.exits, order.seed) if now < wrong else here.route


def reversal(_t: float, guidance: Guidance, order: Order) -> Command:
    """Return another direction in the last part of a window, the dose past the stop line."""
    here = guidance.within()
    return guidance.command if here is None or here.to_line > -order.dose else not_the_route(here.route, order.seed)


def dropout(_t: float, guidance: Guidance, order: Order) -> Command:
    """Return VOID in the first part of a window."""
    here = guidance.within()
    if here is None:
        return guidance.command
    whole = guidance.window + (here.to_exit - here.to_line) + AFTER
    return Command.VOID if guidance.window - here.to_line <= order.dose * whole else guidance.command


def corrected(t: float, guidance: Guidance, order: Order) -> Command:
    """Return the missing direction in a window until the dose before the stop line."""
    here = guidance.within()
    return guidance.command if here is None or here.to_line <= order.dose else infeasible(t, guidance, order)


def contradiction(_t: float, guidance: Guidance, _order: Order) -> Command:
    """Return the route's command: only what is said beside it, such as a sentence, names a wrong direction."""
    return guidance.command


RULES: dict[str, Callable[[float, Guidance, Order], Command]] = {
    rule.__name__: rule
    for rule in (
        none, infeasible, omission, substitution, prohibited, commission, late, early,
        stuck, sequence, flicker, reversal, dropout, corrected, contradiction,
    )
}  # fmt: skip
"""What each fault delivers ``t`` seconds after the start, by its name."""
DOSES = {"late": 15.0, "early": 20.0, "flicker": 0.5, "reversal": 5.0, "dropout": 0.5, "corrected": 5.0}
"""Usual doses of the faults that have one."""
