"""Starts and routes of trials, drawn from the trial's seed."""

import math
import random
from typing import TYPE_CHECKING, Final

from wrongturn_networks.errors import ApproachTooShortError, RouteNotAvailableError
from wrongturn_networks.town import Town
from wrongturn_protocol import Command, Fault, FaultKind, Start, Traffic, Trial, Weather, trial_id

if TYPE_CHECKING:
    from wrongturn_networks.faults import CommandFault

LANE_RESERVE = 3.0
"""A start lies at least this far from the lane's beginning, metres, so never in the previous junction."""
ENGAGED = 15.0
"""A car this near to the stop line is engaged and judged, metres."""
SHORTEST = ENGAGED + 2.0
"""Least distance of a start from the stop line, metres: a nearer car could not stop before it is engaged."""
WINDOW: Final = (10.0, 20.0)
"""Range in which a drawn window of the command opens, metres before the stop line."""


def draw_start(lane_length: float, seed: int, least: float = 0.0) -> Start:
    """Draw a start on an approach's lane (metres) from a seed, at least so far before the stop line if it has the room.

    Raises ApproachTooShortError if the lane has no room for a start.
    """
    check_room(lane_length)
    draw = random.Random(seed)
    distance = min(draw.uniform(22, 30) + max(least - 22, 0.0), lane_length - LANE_RESERVE)
    return slow_start(distance, draw.uniform(4, 9), draw.uniform(-0.4, 0.4), draw.uniform(-6, 6))


def check_room(lane_length: float) -> None:
    """Check that a trial can start on an approach's lane. Raises ApproachTooShortError."""
    if lane_length < SHORTEST + LANE_RESERVE:
        raise ApproachTooShortError(
            f"approach: its lane is {lane_length:.1f} m long and a start needs {SHORTEST + LANE_RESERVE:.0f} m; "
            "choose another approach"
        )


def slow_start(distance: float, speed: float, lateral: float, yaw: float) -> Start:
    """Return a start, slower if the car could not stop before it is engaged. Metres, m/s and degrees, unrounded."""
    # At 8 m/s² a car stops within v²/16 metres: before it is engaged, with a metre to spare.
    speed = min(speed, math.sqrt(16 * (distance - ENGAGED - 1)))
    return Start(
        distance=round(distance, 3), speed=round(speed, 3), lateral=round(lateral, 3), yaw=round(math.radians(yaw), 5)
    )


def draw_trial(
    town: Town,
    approach_id: str,
    fault: FaultKind | Fault,
    seed: int,
    *,
    route: Command | None = None,
    weather: Weather = Weather.CLEAR_NOON,
    traffic: Traffic = Traffic(),  # noqa: B008 - immutable
) -> Trial:
    """Draw a trial at an approach by the suites' recipe.

    Whether the fault can be applied there is the fault's own to say: ask ``wrongturn_networks.faults.check_fault``. If
    it can be with another route only, the trial has that route.
    Raises UnknownApproachError, RouteNotAvailableError if the approach has no such exit, and ApproachTooShortError if
    its lane has no room for a start.
    """
    approach = town.approach(approach_id)
    wanted = fault if isinstance(fault, Fault) else Fault(kind=fault)
    if route is not None and route not in approach.exits:
        names = ", ".join(command.name for command in approach.exits)
        raise RouteNotAvailableError(f"route: {town.name} {approach_id} has no exit {route.name}; it has: {names}")
    # A generator of its own, so that choosing a route does not change the start.
    chosen = random.Random(f"route {seed}").choice(list(approach.exits)) if route is None else route
    drawn = Trial(
        id=trial_id(town.name, approach_id, wanted, seed),
        town=town.name,
        approach=approach_id,
        junction_type=approach.type,
        route=chosen,
        start=draw_start(town.lanes[approach.lane].length, seed, room_for(wanted)),
        weather=weather,
        traffic=traffic,
        fault=wanted,
        seed=seed,
        scenery=town.scenery_seed,
    )
    trial, built = fitted(drawn, town), _class_of(wanted)
    for other in approach.exits if route is None and built is not None and built.refusal(trial) else ():
        another = fitted(drawn.model_copy(update={"route": other}), town)
        if built is not None and not built.refusal(another):
            return another
    return trial


def _class_of(fault: Fault) -> "type[CommandFault] | None":
    from wrongturn_networks.faults import find_fault  # noqa: PLC0415 - it draws trials, so it comes later

    return find_fault(fault.kind)


def room_for(fault: Fault) -> float:
    """Return how far before the stop line a trial with a fault starts at least, metres; 0 for a start as usual."""
    built = _class_of(fault)
    return built.room(fault) if built is not None else 0.0


def fitted(trial: Trial, town: Town) -> Trial:
    """Return a newly drawn trial with what its fault needs besides."""
    built = _class_of(trial.fault)
    following = town.approach_of_lane(town.approach(trial.approach).exits[trial.route].lane)
    onward = frozenset(following.exits) if following is not None else frozenset[Command]()
    return trial if built is None else built.fitted(trial, onward)
