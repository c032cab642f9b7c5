"""The compiled part of the route planner: it follows a car along its route.

A town's lanes and exits are arrays (:class:`~wrongturn_sim.roads.Roads`). A *leg* is a lane together with the junction
at its end, a *gate* is one of its exits. A *way* gives the exit to take at the end of each leg: the one on the shortest
way to a goal, or DRAWN. A car's progress is an array too: :class:`~wrongturn_sim.route.Navigator` keeps one, and a
fleet keeps one row for each car.
"""

import math
from typing import Any

import numpy as np
from numba import njit

from wrongturn_judge.compiling import compiled_with
from wrongturn_judge.kernels import Array
from wrongturn_sim import polyline
from wrongturn_sim.polyline import fill, project

WINDOW_BEFORE = 15.0
"""The nominal window opens this far before the stop line, metres along the lane. A trial can have its own."""
WINDOW_AFTER = 5.0
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

# Integers of a leg: first and end index of its lane's points; whether the lane leads into a junction; the direction
# that the approach lacks (0: none); the leg of the street's opposite lane (-1: none); the number of exits. Then for
# each exit: its direction, its leg, first and end index of its path's points.
L_FIRST, L_END, L_APPROACH, L_MISSING, L_BACK, L_GATES, L_GATE = 0, 1, 2, 3, 4, 5, 6
GATE_INTS = 4
G_DIRECTION, G_LEG, G_FIRST, G_END = 0, 1, 2, 3
LEG_INTS = L_GATE + 3 * GATE_INTS
# Floats of a leg: the lane's length. Then for each exit: the point where its lane begins, the lane's unit vector there,
# half its width, and the length of the path to the exit line.
F_LENGTH, F_GATE = 0, 1
GATE_FLOATS = 6
G_X, G_Y, G_UX, G_UY, G_HALF_WIDTH, G_INNER = 0, 1, 2, 3, 4, 5
LEG_FLOATS = F_GATE + 3 * GATE_FLOATS

# Integers of a car's progress: the leg; the exit that the route takes (-1: none); whether the car is in the junction;
# the leg whose window still holds past its exit line (-1: none), and that window's command; the number of draws used;
# whether it is a journey, which is planned anew wherever the car returns to a lane.
P_LEG, P_GATE, P_INSIDE, P_AFTER, P_AFTER_COMMAND, P_DRAWN, P_JOURNEY = 0, 1, 2, 3, 4, 5, 6
PROGRESS_INTS = 7
# Floats of a car's progress: metres along the lane, or along the route's path within the junction; metres travelled in
# the window that still holds, at its exit line; how far before stop lines the trial's windows open, metres.
P_S, P_AFTER_TRAVELLED, P_WINDOW = 0, 1, 2
PROGRESS_FLOATS = 3

DRAWN, NONE = -2, -1
"""Entries of a way: the leg's exit is drawn; there is no exit."""
DRAWS = 64
"""Number of random draws of a route. An exit uses two or fewer on average; after the last, the first comes again."""


@njit(cache=True)
def taken(floats: Array, leg: int, k: int, x: float, y: float) -> bool:
    """Return whether a point lies in the lane of a leg's exit ``k``, shortly past the exit line."""
    gate = F_GATE + GATE_FLOATS * k
    dx = x - floats[leg, gate + G_X]
    dy = y - floats[leg, gate + G_Y]
    ux = floats[leg, gate + G_UX]
    uy = floats[leg, gate + G_UY]
    half = floats[leg, gate + G_HALF_WIDTH]
    within: bool = 0.0 <= dx * ux + dy * uy <= GATE_DEPTH and -half <= ux * dy - uy * dx <= half
    return within


@njit(cache=True)
def choose(draws: Array, progress: Array, count: int) -> Any:
    """Return one of ``count`` exits, at most three, drawn as ``random.choice`` does.

    It reads the highest bits of one 32-bit draw after the other until they are the number of an exit.
    """
    shift = 31 if count == 1 else 30
    for _ in range(DRAWS):
        pick = draws[progress[P_DRAWN] % DRAWS] >> shift
        progress[P_DRAWN] += 1
        if pick < count:
            return np.int64(pick)
    return 0


@njit(cache=True)
def enter(ints: Array, draws: Array, way: Array, progress: Array, leg: int) -> None:
    """Plan the route anew from a lane."""
    progress[P_LEG] = leg
    progress[P_INSIDE] = 0
    if way[leg] != DRAWN:
        progress[P_GATE] = way[leg]
    else:
        progress[P_GATE] = choose(draws, progress, ints[leg, L_GATES]) if ints[leg, L_GATES] > 0 else NONE


@njit(cache=True)
def leave(ints: Array, floats: Array, draws: Array, way: Array, progress: Array, places: Array, k: int) -> None:
    """Plan the route anew from the lane of exit ``k``, which the car took, whether it was the route's or not."""
    leg = progress[P_LEG]
    progress[P_AFTER] = leg
    progress[P_AFTER_COMMAND] = ints[leg, L_GATE + GATE_INTS * progress[P_GATE] + G_DIRECTION]
    places[P_AFTER_TRAVELLED] = places[P_WINDOW] + floats[leg, F_GATE + GATE_FLOATS * k + G_INNER]
    enter(ints, draws, way, progress, ints[leg, L_GATE + GATE_INTS * k + G_LEG])


@compiled_with(polyline)
def found_again(points: Array, along: Array, ints: Array, floats: Array, progress: Array, x: float, y: float) -> int:
    """Return the leg of a car that entered an exit's lane late, or turned round in the junction; -1 for none."""
    leg = progress[P_LEG]
    back = ints[leg, L_BACK]
    for k in range(ints[leg, L_GATES] + 1):
        if k < ints[leg, L_GATES]:
            half = floats[leg, F_GATE + GATE_FLOATS * k + G_HALF_WIDTH]
            lane, least = ints[leg, L_GATE + GATE_INTS * k + G_LEG], GATE_DEPTH
        elif back >= 0:
            half = floats[leg, F_GATE + G_HALF_WIDTH]
            lane, least = back, BACK
        else:
            break
        s, lateral, _ = project(points, along, ints[lane, L_FIRST], ints[lane, L_END], x, y)
        if least <= s < floats[lane, F_LENGTH] and -half <= lateral <= half:
            return int(lane)
    return -1


@compiled_with(polyline)
def update(
    points: Array, along: Array, ints: Array, floats: Array, draws: Array, way: Array, progress: Array,
    places: Array, x: float, y: float,
) -> tuple[int, int, float, float, float]:  # fmt: skip
    """Update a car's progress for the current place of the body's centre.

    Args:
        points: (N, 2), of all lines of the town.
        along: (N,), distances along each line.
        ints: (legs, LEG_INTS).
        floats: (legs, LEG_FLOATS).
        draws: (DRAWS,) uint32, the random draws of the route.
        way: (legs,), the number of each leg's exit, DRAWN or NONE.
        progress: (PROGRESS_INTS,), changed.
        places: (PROGRESS_FLOATS,), changed.
        x: metres.
        y: metres.

    Returns:
        The route's command; the leg of the window's approach or, outside a window, of the approach ahead (-1: none);
        metres travelled since the window began; distance from the path, metres; heading of the path, radians.
    """
    leg = progress[P_LEG]
    if progress[P_INSIDE]:
        for k in range(ints[leg, L_GATES]):
            if taken(floats, leg, k, x, y):
                leave(ints, floats, draws, way, progress, places, k)
                leg = progress[P_LEG]
                break
    if progress[P_INSIDE] and progress[P_JOURNEY]:
        gate = L_GATE + GATE_INTS * progress[P_GATE]
        s, lateral, heading = project(points, along, ints[leg, gate + G_FIRST], ints[leg, gate + G_END], x, y)
        inner = floats[leg, F_GATE + GATE_FLOATS * progress[P_GATE] + G_INNER]
        if abs(lateral) > _ASTRAY or s > inner + GATE_DEPTH:
            lane = found_again(points, along, ints, floats, progress, x, y)
            if lane >= 0:
                enter(ints, draws, way, progress, lane)
                progress[P_AFTER] = -1
                leg = lane
    if not progress[P_INSIDE]:
        s, lateral, heading = project(points, along, ints[leg, L_FIRST], ints[leg, L_END], x, y)
        places[P_S] = s
        if progress[P_AFTER] >= 0:
            if s <= WINDOW_AFTER:
                travelled = places[P_AFTER_TRAVELLED] + s
                return progress[P_AFTER_COMMAND], progress[P_AFTER], travelled, lateral, heading
            progress[P_AFTER] = -1
        if progress[P_GATE] < 0:
            return LANE_FOLLOW, -1, math.inf, lateral, heading
        left = floats[leg, F_LENGTH] - s
        if left > _AT_END:
            command = LANE_FOLLOW
            if left <= places[P_WINDOW]:
                command = ints[leg, L_GATE + GATE_INTS * progress[P_GATE] + G_DIRECTION]
            return command, leg, places[P_WINDOW] - left, lateral, heading
        progress[P_INSIDE] = 1
    gate = L_GATE + GATE_INTS * progress[P_GATE]
    s, lateral, heading = project(points, along, ints[leg, gate + G_FIRST], ints[leg, gate + G_END], x, y)
    places[P_S] = s
    return ints[leg, gate + G_DIRECTION], leg, places[P_WINDOW] + s, lateral, heading


@njit(cache=True)
def stop_line(ints: Array, floats: Array, progress: Array, places: Array) -> float:
    """Return metres along the lane to the stop line; -1 within a junction and where none lies within 60 m."""
    leg = progress[P_LEG]
    left = floats[leg, F_LENGTH] - places[P_S]
    return -1.0 if progress[P_INSIDE] or not ints[leg, L_APPROACH] or left > VISIBLE_RANGE else left


@compiled_with(polyline)
def lane_ahead(
    points: Array, along: Array, ints: Array, floats: Array, progress: Array, places: Array, out: Array
) -> None:
    """Fill ``out`` (n, 2) with the lane's centre line ahead, 1 m apart; within a junction, with the lane's end."""
    leg = progress[P_LEG]
    begin = floats[leg, F_LENGTH] if progress[P_INSIDE] else places[P_S]
    fill(points, along, ints[leg, L_FIRST], ints[leg, L_END], begin, out)


def route_draws(random: Any) -> Array:
    """Return the random draws of a route, taken from a ``random.Random`` of its own."""
    return np.frombuffer(random.getrandbits(32 * DRAWS).to_bytes(4 * DRAWS, "little"), "<u4").copy()
