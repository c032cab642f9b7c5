"""The decision of a journey's judge, compiled: it updates a journey's state with one row, anywhere in the town.

The arithmetic is plain float64 without fastmath, as in ``decide.py``. ``geometry.py`` packs all junction areas and all
lanes of the town, as ``packing.py`` describes.
"""

import math
from typing import Any

import numpy as np

from wrongturn_judge import decide, kernels
from wrongturn_judge.compiling import compiled, record
from wrongturn_judge.decide import KERB_BITE, LANE_INVASION, NOT_LATER, STATE, WRONG_WAY_FLAG
from wrongturn_judge.kernels import (
    NOT_FINITE,
    Array,
    Ground,
    cell_at,
    contact_with_solids,
    contact_with_users,
    covers,
    project,
)

ARRIVED = 14
"""Number of this verdict, in the vocabulary's order."""
TERMS = record("limit goal at strict")
"""What ends a journey: its time limit; the goal's lane (-1: none) and metres along it; whether it is strict."""


@compiled()
def lane_at(ground: Ground, lanes: Array, cell: int, x: float, y: float) -> int:
    """Return the number of the lane that a point of a cell lies in; -1 in a junction's area and outside all lanes."""
    found: Any = np.int64(lanes[cell]) if cell >= 0 else 0
    if found == 0:
        return -1
    head, floats, ints = ground.head[0], ground.floats, ground.ints
    area: Any = (np.int64(ground.cells[cell]) >> 2) & 3
    if area == kernels.AREA_EDGE:
        for k in range(head.areas):
            table = head.area_table + 2 * k
            if covers(floats, ints[table], ints[table + 1], x, y):
                return -1
    elif area != 0:
        return -1
    if found > 0:
        return int(found - 1)
    width = head.candidates_width
    first = head.candidates - (found + 1) * width
    for i in range(first, first + width):
        lane = ints[i]
        if lane < 0:
            break
        table = head.lane_table + 4 * lane
        if covers(floats, ints[table], ints[table + 1], x, y):
            return int(lane)
    return -1


@compiled()
def drive_along(ground: Ground, state: Any, terms: Any, rest: Array, lane: int, along: float) -> bool:
    """Count a junction when the car comes to another lane, and the metres left; return whether it is at its goal."""
    ints = ground.ints
    if lane != state.lane:
        if state.lane >= 0:
            for k in range(3):
                if ints[ground.head[0].onward + 3 * state.lane + k] == lane:
                    state.junctions += 1
                    break
        state.lane = lane
    goal = int(terms.goal)
    if goal < 0:
        return False
    if lane == goal and along >= terms.at:
        state.left = 0.0
        return True
    left = terms.at - along
    if lane != goal:
        table = ground.head[0].lane_table + 4 * lane
        last = ints[table + 2] + 6 * (ints[table + 3] - 1)
        left += ground.floats[last + 5] + ground.floats[last + 4] + rest[lane]
    state.left = min(state.left, left)
    return False


@compiled()
def observe(
    head: Array, floats: Array, ints: Array, cells: Array, lanes: Array, numbers: Array, users: Array, terms: Array,
    rest: Array, row: Array, t: float, x: float, y: float, yaw: float, v: float,
) -> int:  # fmt: skip
    """Take the next row: place and heading (metres, radians) and speed (m/s).

    The first four are the packed geometry: ``cells`` has road and junction areas, ``lanes`` the lane of each cell.
    ``numbers`` is a row of NUMBERS; ``users`` (n, 6) are the other road users; ``terms`` is a TERMS; ``rest`` has the
    metres from each lane's end to the start of the goal's lane, by the shortest way; ``row`` is a STATE, which changes.

    Returns:
        The verdict at this row, 0 for none; NOT_LATER or NOT_FINITE for a row that cannot be judged, which changes
        nothing.
    """
    state = row.view(STATE)[0]
    if not t > state.t:
        return NOT_LATER
    if not math.isfinite(x + y + yaw + v):
        return NOT_FINITE
    ground, limits = Ground(head.view(kernels.HEAD), floats, ints, cells), numbers.view(kernels.NUMBERS)[0]
    ends = terms.view(TERMS)[0]
    c = math.cos(yaw)
    s = math.sin(yaw)
    if not math.isnan(state.x):
        dx = x - state.x
        dy = y - state.y
        state.driven += math.sqrt(dx * dx + dy * dy)
    if v >= limits.journey_stop_speed:
        state.slow_since = math.nan
    elif math.isnan(state.slow_since):
        state.slow_since = t

    cell = cell_at(ground.head[0], x, y)
    wheels = kernels.wheels_off(ground, limits, x, y, c, s)
    off = wheels >= limits.wheels_off or cell < 0 or not kernels.road_in(ground, cell, x, y)
    if off:
        if t - state.last_off >= limits.journey_back_time:
            state.off += 1
        state.last_off = t
    elif wheels:
        state.flags |= KERB_BITE

    arrived = oncoming = False
    lane = lane_at(ground, lanes, cell, x, y)
    if lane >= 0:
        table = ground.head[0].lane_table + 4 * lane
        along, _, ux, uy = project(floats, ints[table + 2], ints[table + 3], x, y)
        oncoming = c * ux + s * uy < 0.0
        if not oncoming:
            arrived = drive_along(ground, state, ends, rest, lane, along)
    if oncoming:
        state.flags |= LANE_INVASION
        if math.isnan(state.oncoming_since):
            state.oncoming_since = t
        if t - state.last_wrong >= limits.journey_back_time:
            state.wrong += 1
        state.last_wrong = t
    else:
        state.oncoming_since = math.nan

    users_time = contact_with_users(limits, users, x, y, c, s, v)
    solids_time = contact_with_solids(ground, limits, x, y, c, s, v)
    hit = users_time < 0.0 or solids_time < 0.0
    decide.keep(state, t, x, y, yaw, v, max(users_time, 0.0), max(solids_time, 0.0))

    verdict = 0
    strict = ends.strict != 0.0
    if hit:
        verdict = decide.COLLISION
    elif strict and off:
        verdict = decide.OFF_ROAD
    elif strict and t - state.oncoming_since >= limits.journey_wrong_way_time:  # False for nan
        verdict = decide.WRONG_WAY
        state.flags |= WRONG_WAY_FLAG
    elif strict and t - state.slow_since >= limits.journey_stand_time:
        verdict = decide.NOT_ENGAGED
    elif arrived:
        verdict = ARRIVED
    elif t >= ends.limit:
        verdict = decide.TIMEOUT
        state.ran_out = 1
    state.verdict = verdict
    return verdict
