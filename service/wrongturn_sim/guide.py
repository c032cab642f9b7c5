"""The compiled part of the route planner: it follows a car along its route.

A town's lanes and exits are arrays (:class:`~wrongturn_sim.roads.Roads`). A *leg* is a lane together with the junction
at its end, a *gate* is one of its exits. A *way* gives the exit to take at the end of each leg: the one on the shortest
way to a goal, or DRAWN. A car's progress is a row: :class:`~wrongturn_sim.route.Navigator` keeps one, and a fleet keeps
one for each car.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from wrongturn_faults.rules import AFTER
from wrongturn_judge.compiling import compiled, record
from wrongturn_judge.kernels import Array
from wrongturn_sim.polyline import fill, project

WINDOW_AFTER = AFTER
"""The window ends this far past the exit line, metres."""
VISIBLE_RANGE = 60.0
"""Observations show stop lines and exits within this distance, metres."""
GATE_DEPTH = 30.0
"""A car in an exit's lane, at most this far past the exit line, has taken the exit, metres."""
LANE_FOLLOW = 4
"""Number of the command outside windows."""
BACK = 5.0
"""A car that is this far along its own street's opposite lane has turned round, metres."""
_AT_END = 1e-6
_ASTRAY = 3.0  # a journey's car this far from the route's path may be on another lane, metres

LEG = record("length", "first end approach missing back gates")
"""Length of the lane, metres; first and end index of its points; whether it leads into a junction; the direction that
the approach lacks (0: none); the leg of the street's opposite lane (-1: none); the number of exits."""
GATE = record("x y ux uy half_width inner", "direction leg first end")
"""Point where the exit's lane begins, the lane's unit vector there, and half its width; length of the path to the exit
line; direction and leg of the exit; first and end index of its path's points."""
PROGRESS = record("s window", "leg gate inside after last taken last_command passed next drawn journey")
"""Metres along the lane, or along the route's path within the junction; how far before stop lines the trial's windows
open, metres. The leg; the exit that the route takes (-1: none); whether the car is in the junction; whether the window
of the last junction still holds past its exit line; the leg of that junction (-1: none), the exit that the car took
there, and the route's direction; the number of junctions that were passed; the route's direction at the next junction
if the trial sets it (0: it does not); the number of draws used; whether it is a journey, which is planned anew wherever
the car returns to a lane."""

DRAWN, NONE = -2, -1
"""Entries of a way: the leg's exit is drawn; there is no exit."""
DRAWS = 64
"""Number of random draws of a route. An exit uses two or fewer on average; after the last, the first comes again."""


class Net(NamedTuple):
    """A town's lanes and exits."""

    points: Array
    """(N, 2), metres: points of every lane, and of every exit's path, which leads from the stop line through the
    junction and along the exit's lane."""
    along: Array
    """(N,): distances along each line, metres."""
    legs: Array
    """(legs,) of LEG"""
    gates: Array
    """(legs, 3) of GATE"""


@compiled()
def net_of(points: Array, along: Array, legs: Array, gates: Array) -> Net:
    """Return the arrays of :attr:`wrongturn_sim.roads.Roads.tables` as kernels look at them."""
    return Net(points, along, legs.view(LEG)[:, 0], gates.view(GATE)[:, :, 0])


@compiled()
def taken(gate: Any, x: float, y: float) -> bool:
    """Return whether a point lies in the lane of an exit, shortly past the exit line."""
    dx, dy = x - gate.x, y - gate.y
    half = gate.half_width
    within: bool = 0.0 <= dx * gate.ux + dy * gate.uy <= GATE_DEPTH and -half <= gate.ux * dy - gate.uy * dx <= half
    return within


@compiled()
def choose(draws: Array, progress: Any, count: int) -> Any:
    """Return one of ``count`` exits, at most three, drawn as ``random.choice`` does.

    It reads the highest bits of one 32-bit draw after the other until they are the number of an exit.
    """
    shift = 31 if count == 1 else 30
    for _ in range(DRAWS):
        pick = draws[progress.drawn % DRAWS] >> shift
        progress.drawn += 1
        if pick < count:
            return np.int64(pick)
    return 0


@compiled()
def enter(net: Net, draws: Array, way: Array, progress: Any, leg: int) -> None:
    """Plan the route anew from a lane."""
    progress.leg, progress.inside = leg, 0
    if way[leg] != DRAWN:
        progress.gate = way[leg]
    else:
        progress.gate = choose(draws, progress, net.legs[leg].gates) if net.legs[leg].gates > 0 else NONE


@compiled()
def leave(net: Net, draws: Array, way: Array, progress: Any, k: int) -> None:
    """Plan the route anew from the lane of exit ``k``, which the car took, whether it was the route's or not."""
    leg, planned = progress.leg, progress.gate
    progress.after, progress.last, progress.taken = 1, leg, k
    progress.last_command = net.gates[leg, planned].direction
    progress.passed += 1
    enter(net, draws, way, progress, net.gates[leg, k].leg)
    if k == planned and progress.next:
        for gate in range(net.legs[progress.leg].gates):
            if net.gates[progress.leg, gate].direction == progress.next:
                progress.gate = gate
    progress.next = 0


@compiled()
def found_again(net: Net, leg: int, x: float, y: float) -> int:
    """Return the leg of a car that entered an exit's lane late, or turned round in the junction; -1 for none."""
    count, back = net.legs[leg].gates, net.legs[leg].back
    for k in range(count + 1 if back >= 0 else count):
        # After the exits comes the way back, which is as wide as the first exit.
        half = net.gates[leg, k if k < count else 0].half_width
        lane, least = (net.gates[leg, k].leg, GATE_DEPTH) if k < count else (back, BACK)
        s, lateral, _ = project(net.points, net.along, net.legs[lane].first, net.legs[lane].end, x, y)
        if least <= s < net.legs[lane].length and -half <= lateral <= half:
            return int(lane)
    return -1


@compiled()
def update(
    points: Array, along: Array, legs: Array, gates: Array, draws: Array, way: Array, row: Array, x: float, y: float
) -> tuple[int, int, float, float]:
    """Update a car's progress for the current place of the body's centre.

    The first four are :attr:`wrongturn_sim.roads.Roads.tables`. ``draws`` (DRAWS,) uint32 are the route's random draws;
    ``way`` (legs,) has the number of each leg's exit, DRAWN or NONE; ``row`` is a PROGRESS, which changes. ``x`` and
    ``y`` are metres.

    Returns:
        The route's command; the leg of the window's approach or, outside a window, of the approach ahead (-1: none);
        distance from the path, metres; heading of the path, radians.
    """
    net, progress = net_of(points, along, legs, gates), row.view(PROGRESS)[0]
    leg = progress.leg
    if progress.inside:
        for k in range(net.legs[leg].gates):
            if taken(net.gates[leg, k], x, y):
                leave(net, draws, way, progress, k)
                leg = progress.leg
                break
    if progress.inside and progress.journey:
        gate = net.gates[leg, progress.gate]
        s, lateral, heading = project(points, along, gate.first, gate.end, x, y)
        if abs(lateral) > _ASTRAY or s > gate.inner + GATE_DEPTH:
            lane = found_again(net, leg, x, y)
            if lane >= 0:
                enter(net, draws, way, progress, lane)
                progress.after, progress.last = 0, -1
                leg = lane
    if not progress.inside:
        s, lateral, heading = project(points, along, net.legs[leg].first, net.legs[leg].end, x, y)
        progress.s = s
        if progress.after:
            if s <= WINDOW_AFTER:
                return progress.last_command, progress.last, lateral, heading
            progress.after = 0
        if progress.gate < 0:
            return LANE_FOLLOW, -1, lateral, heading
        left = net.legs[leg].length - s
        if left > _AT_END:
            command = net.gates[leg, progress.gate].direction if left <= progress.window else LANE_FOLLOW
            return command, leg, lateral, heading
        progress.inside = 1
    gate = net.gates[leg, progress.gate]
    s, lateral, heading = project(points, along, gate.first, gate.end, x, y)
    progress.s = s
    return gate.direction, leg, lateral, heading


@compiled()
def passages(
    legs: Array, gates: Array, row: Array
) -> tuple[float, int, int, int, float, float, int, int, float, float]:
    """Return where windows open, the number of junctions passed, the last junction and the one ahead.

    Of each junction: the route's direction, the leg (-1: none), and metres along the route to the stop line and the
    exit line. ``row`` is a PROGRESS that was updated.
    """
    progress = row.view(PROGRESS)[0]
    ahead, last, s = progress.leg, progress.last, progress.s
    direction, to_line, to_exit, past_line, past_exit = 0, math.inf, math.inf, 0.0, 0.0
    if progress.gate < 0:
        ahead = -1
    else:
        gate = gates.view(GATE)[ahead, progress.gate, 0]
        direction = gate.direction
        to_line = -s if progress.inside else legs.view(LEG)[ahead, 0].length - s
        to_exit = to_line + gate.inner
    if last >= 0:
        # In the junction after it, the whole lane between lies behind the car.
        past_exit = legs.view(LEG)[progress.leg, 0].length + s if progress.inside else s
        past_line = past_exit + gates.view(GATE)[last, progress.taken, 0].inner
    return (
        progress.window, progress.passed,
        progress.last_command, last, -past_line, -past_exit, direction, ahead, to_line, to_exit,
    )  # fmt: skip


@compiled()
def follow(
    points: Array, along: Array, legs: Array, gates: Array, draws: Array, way: Array, row: Array, x: float, y: float
) -> tuple[int, float, float, tuple[float, int, int, int, float, float, int, int, float, float]]:
    """Update a car's progress as :func:`update`; return the command, lateral, heading, and :func:`passages`."""
    command, _, lateral, heading = update(points, along, legs, gates, draws, way, row, x, y)
    return command, lateral, heading, passages(legs, gates, row)


@compiled()
def stop_line(legs: Array, row: Array) -> float:
    """Return metres along the lane to the stop line; -1 within a junction and where none lies within 60 m."""
    progress = row.view(PROGRESS)[0]
    leg = legs.view(LEG)[progress.leg, 0]
    left = leg.length - progress.s
    return -1.0 if progress.inside or not leg.approach or left > VISIBLE_RANGE else left


@compiled()
def lane_ahead(points: Array, along: Array, legs: Array, row: Array, out: Array) -> None:
    """Fill ``out`` (n, 2) with the lane's centre line ahead, 1 m apart; within a junction, with the lane's end."""
    progress = row.view(PROGRESS)[0]
    leg = legs.view(LEG)[progress.leg, 0]
    fill(points, along, leg.first, leg.end, leg.length if progress.inside else progress.s, out)


@compiled()
def legs_ahead(
    points: Array, along: Array, legs: Array, gates: Array, draws: Array, way: Array, row: Array, metres: float
) -> list[int]:
    """Return the legs of the route ahead; those after the first add up to ``metres`` or more. Changes the progress."""
    net, progress = net_of(points, along, legs, gates), row.view(PROGRESS)[0]
    found = [progress.leg]
    while progress.gate >= 0 and metres > 0.0:
        leave(net, draws, way, progress, progress.gate)
        found.append(progress.leg)
        metres -= net.legs[progress.leg].length
    return found
