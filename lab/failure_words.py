"""Sentences about how an agent fails, made of what was measured and of nothing else."""

from collections.abc import Callable, Iterable, Sequence
from statistics import median
from types import MappingProxyType
from typing import Final

from lab.failures import Contact, Ending, Film, FilmedWay, Measures, Other, Way
from wrongturn_protocol import Command, FaultKind, JunctionType, Reaction

_FASTER: Final = 1.0
"""Difference of two speeds that is worth a word, m/s."""
_LATER: Final = 2.0
"""Difference of two places that is worth a word, m."""
_STEERS: Final = 0.2
"""Steering that counts as a decision for a side."""
_LESS: Final = 0.15
"""Difference in steering that is worth a word."""
_STANDS: Final = 1.0
"""Speed below which a car nearly stands, m/s."""
_SLIDES_S: Final = 0.1
"""Seconds of running wide that are worth a word."""
_WIDE: Final = 30.0
"""Degrees after which a car that leaves the road was turning, not driving straight on."""

ROADS: Final = MappingProxyType(
    {
        JunctionType.LEFT_RIGHT: "left and right",
        JunctionType.STRAIGHT_LEFT: "straight on and left",
        JunctionType.STRAIGHT_RIGHT: "straight on and right",
        JunctionType.CROSS: "in all directions",
    }
)
"""Where roads lead from a junction type's approach."""
_ENDINGS: Final = MappingProxyType(
    {
        Ending.COLLISION: "hits something",
        Ending.OFF_ROAD: "leaves the road",
        Ending.STOPPED_IN_JUNCTION: "stops in the junction",
        Ending.WRONG_WAY: "takes no permitted exit",
        Ending.OPPOSED_LANE: "drives on an opposed lane",
        Ending.EXIT: "takes an exit",
        Ending.STOPPED_BEFORE_JUNCTION: "stops before the junction",
        Ending.ABORTED: "is given up",
        Ending.OTHER: "runs out of time",
    }
)
_OTHERS: Final = MappingProxyType(
    {
        Other.PEDESTRIAN: "hits a pedestrian",
        Other.AHEAD: "drives into a vehicle ahead",
        Other.CROSSING: "hits a vehicle that comes from the side",
        Other.ONCOMING: "hits an oncoming vehicle",
        Other.BEHIND: "is hit by a vehicle from behind",
        Other.SCENERY: "hits scenery",
    }
)
_Value = Callable[[Measures], float | None]


def told(way: Way) -> str:
    """Return the wrong command of a way, as the page's headings say it."""
    missing = way.junction_type.missing
    if way.fault is FaultKind.INFEASIBLE and missing is not None:
        return missing.name
    return "No command" if way.fault is FaultKind.OMISSION else way.fault.capitalize()


def heading(way: Way) -> str:
    """Return the heading of a way: ``STRAIGHT where roads lead left and right: leaves the road``."""
    side = ""
    if way.fault is FaultKind.INFEASIBLE and way.ending in {Ending.OFF_ROAD, Ending.COLLISION}:
        side = " where it was told to go" if way.reaction is Reaction.OBEYED else " elsewhere"
    return f"{told(way)} where roads lead {ROADS[way.junction_type]}: {_ENDINGS[way.ending]}{side}"


def explanation(filmed: FilmedWay) -> str:
    """Return a few sentences: why the drives of a way end so; then how they enter the junction, turn, and end."""
    own, twins = [one.own for one in filmed.drives], [one.twin for one in filmed.drives]
    return " ".join(
        [_why(filmed.way, own, twins), _enters(own, twins), *_turns(filmed.way, own, twins), *_ends(filmed.way, own)]
    )


def shown(agent: str, filmed: FilmedWay, film: Film) -> str:
    """Return the alternative text of a way's film: what happens in this one drive."""
    own = next(one.own for one in filmed.drives if one.trial == film.trial)
    way = filmed.way
    happens = [] if own.line_speed is None else [f"it crosses the stop line at {own.line_speed:.1f} m/s"]
    if abs(own.turned) >= 10:
        happens.append(f"turns {abs(own.turned):.0f}° {_side(own.turned)}")
    happens.append(_ENDINGS[way.ending])
    what = ", ".join(happens[:-1]) + " and " + happens[-1] if len(happens) > 1 else "it " + happens[0]
    said = "told nothing" if way.fault is FaultKind.OMISSION else f"told {told(way)}"
    return f"Film: {agent}, {said} where roads lead {ROADS[way.junction_type]}, from above and by its camera: {what}."


def spread(values: Iterable[float], unit: str, digits: int = 1) -> str:
    """Return a median with its range: ``4.3 m/s (3.9–4.6)``."""
    known = sorted(values)
    low, high = f"{known[0]:.{digits}f}", f"{known[-1]:.{digits}f}"
    middle = f"{median(known):.{digits}f}{unit}"
    return middle if low == high else f"{middle} ({low}–{high})"


def _why(way: Way, own: Sequence[Measures], twins: Sequence[Measures]) -> str:
    """Return what sets the drives of a way apart from their twins."""
    fast, late = _faster(own, twins) >= _FASTER, _later(own, twins) >= _LATER
    if way.fault is FaultKind.OMISSION:
        if way.ending is Ending.EXIT:
            return "It takes an exit." if fast else "It comes as it does with a command, and takes an exit."
        what = " and ".join(["comes too fast"] * fast + ["turns too late"] * late)
        return f"Without a command it {what or 'misses its way'}."
    if way.reaction is Reaction.OBEYED:
        return "It does as it is told."
    if way.ending is Ending.EXIT:
        return "It does not do as it is told, and takes an exit."
    turned = median(abs(one.turned) for one in own)
    if way.ending is Ending.OFF_ROAD and turned >= _WIDE:
        return "It does not do as it is told, but turns too wide for the road."
    return "It neither does as it is told nor takes an exit."


def _enters(own: Sequence[Measures], twins: Sequence[Measures]) -> str:
    speeds, usual = _known(own, _line_speed), _known(twins, _line_speed)
    if not speeds:
        return "It does not reach the stop line."
    here = f"It crosses the stop line at {spread(speeds, ' m/s')}"
    if not usual:
        return f"{here}."
    faster = _faster(own, twins)
    how = "faster than" if faster >= _FASTER else "slower than" if faster <= -_FASTER else "much as"
    return f"{here}, {how} with the right command: {spread(usual, ' m/s')}."


def _turns(way: Way, own: Sequence[Measures], twins: Sequence[Measures]) -> Iterable[str]:
    begins = _known(own, _turn_begins)
    if begins:
        later = _later(own, twins)
        late = f", {later:.1f} m later than with the right command" if later >= _LATER else ""
        yield f"It begins to turn {_beside(begins, 'the stop line')}{late}."
    straight = "drives straight on" if way.ending is Ending.EXIT else "does not turn"
    yield from _share(len(own) - len(begins), own, straight)
    side = _side(median(one.turned for one in own))
    tight, needed = _tightest(own, side), _tightest(twins, side)
    if tight and needed and median(needed) - median(tight) >= _LESS:
        yield f"It steers {spread(tight, '', 2)} of full lock."
        yield f"Twins that turn {side} steer {spread(needed, '', 2)}."
    undecided = sum((one.steer_left or 0) >= _STEERS and (one.steer_right or 0) >= _STEERS for one in own)
    if 2 * undecided > len(own):
        yield from _share(undecided, own, "steers to one side and then to the other")
    slides = sum((one.beyond_grip_s or 0) >= _SLIDES_S for one in own)
    yield from _share(slides, own, "steers more than the tyres grip, and runs wide")


def _ends(way: Way, own: Sequence[Measures]) -> Iterable[str]:
    speed = spread([one.end_speed for one in own], " m/s")
    if way.ending is Ending.STOPPED_IN_JUNCTION:
        yield f"It stands {_beside_middle(own)}, with the brake at {spread([one.end_brake for one in own], '', 2)}."
    elif way.ending is Ending.OFF_ROAD:
        nearly = sum(one.slowest is not None and one.slowest < _STANDS < one.end_speed for one in own)
        yield from _share(nearly, own, "nearly stands in the junction first")
        yield f"It leaves the road {_edge(way, own)}, at {speed}, {_turned(own)}."
    elif way.ending is Ending.OPPOSED_LANE:
        yield f"It drives {spread([one.opposed_m for one in own], ' m')} on an opposed lane."
    elif way.ending in {Ending.COLLISION, Ending.WRONG_WAY}:
        yield f"It {_ENDINGS[way.ending]}: it ends {_beside_middle(own)}, at {speed}, {_turned(own)}."


def _edge(way: Way, own: Sequence[Measures]) -> str:
    """Return over which edge of the junction the drives leave the road."""
    missing = way.junction_type.missing
    if missing is Command.STRAIGHT and all(one.past_middle > 0 for one in own):
        return "over the far kerb"
    if missing is Command.LEFT and all(one.left > 0 for one in own):
        return f"over the left kerb, {_beside_middle(own)}"
    if missing is Command.RIGHT and all(one.left < 0 for one in own):
        return f"over the right kerb, {_beside_middle(own)}"
    return _beside_middle(own)


def _beside_middle(own: Sequence[Measures]) -> str:
    return _beside([one.past_middle for one in own], "the junction's middle")


def _beside(places: Sequence[float], mark: str) -> str:
    """Return how far before or past a mark places are, metres; negative before it."""
    if min(places) >= 0:
        return f"{spread(places, ' m')} past {mark}"
    if max(places) <= 0:
        return f"{spread([-one for one in places], ' m')} before {mark}"
    return f"between {-min(places):.1f} m before and {max(places):.1f} m past {mark}"


def _turned(own: Sequence[Measures]) -> str:
    turned = [one.turned for one in own]
    low, high = min(turned), max(turned)
    if low >= 0 or high <= 0:
        return f"turned {spread([abs(one) for one in turned], '°', 0)} {_side(low if high <= 0 else high)}"
    return f"turned between {-low:.0f}° right and {high:.0f}° left"


def _side(turned: float) -> str:
    return "left" if turned >= 0 else "right"


def _tightest(drives: Sequence[Measures], side: str) -> list[float]:
    """Return the most steering past the line of each drive that turns to a side; the sides need different curves."""
    turning = (one for one in drives if one.turn_begins is not None and _side(one.turned) == side)
    return [max(one.steer_left or 0, one.steer_right or 0) for one in turning if one.line_speed is not None]


def _share(count: int, own: Sequence[Measures], what: str) -> Iterable[str]:
    """Return a sentence about some of the drives, if it is true of any."""
    if count:
        yield f"It {what}." if count == len(own) else f"In {count} of {len(own)} it {what}."


def _faster(own: Sequence[Measures], twins: Sequence[Measures]) -> float:
    """Return how much faster than their twins the drives cross the line, m/s; 0 if either never do."""
    speeds, usual = _known(own, _line_speed), _known(twins, _line_speed)
    return median(speeds) - median(usual) if speeds and usual else 0.0


def _later(own: Sequence[Measures], twins: Sequence[Measures]) -> float:
    """Return how much later than their twins the drives begin to turn, m; 0 if either never do."""
    begins, usual = _known(own, _turn_begins), _known(twins, _turn_begins)
    return median(begins) - median(usual) if begins and usual else 0.0


def _line_speed(one: Measures) -> float | None:
    return one.line_speed


def _turn_begins(one: Measures) -> float | None:
    return one.turn_begins


def _known(drives: Sequence[Measures], value: _Value) -> list[float]:
    return [number for one in drives if (number := value(one)) is not None]


def collisions_in_words(contacts: Sequence[Contact]) -> str:
    """Return a sentence for each kind of collision: how often, how fast, and what came before."""
    lines = []
    for other in Other:
        own = [one for one in contacts if one.other is other]
        if not own:
            continue
        inside = sum(one.in_junction for one in own)
        where = "in a junction" if inside == len(own) else f"{inside} of them in a junction" if inside else "on a lane"
        lines.append(
            f"{_times(len(own))} it {_OTHERS[other]}, {where}: at {spread([one.speed for one in own], ' m/s')}"
            + ("" if other is Other.SCENERY else f", the other at {spread([one.other_speed for one in own], ' m/s')}. ")
            + _before(other, own)
        )
    return " ".join(lines)


def _before(other: Other, own: Sequence[Contact]) -> str:
    seen = (
        "" if other is Other.SCENERY else f"The other was in view for {spread([one.in_view_s for one in own], ' s')}. "
    )
    brake, throttle = (spread(values, "", 2) for values in ([one.brake for one in own], [one.throttle for one in own]))
    return f"{seen}In the last two seconds the brake was at {brake} and the throttle at {throttle} on average."


def _times(count: int) -> str:
    return {1: "Once", 2: "Twice"}.get(count, f"{count} times")


def collision_shown(agent: str, contact: Contact) -> str:
    """Return the alternative text of a film of a collision."""
    what = f"it {_OTHERS[contact.other]} at {contact.speed:.1f} m/s"
    return f"Film: {agent} beside other road users, from above and by its camera: {what}."
