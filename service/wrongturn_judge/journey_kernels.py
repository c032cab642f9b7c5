"""The decision of a journey's judge, compiled: it updates a journey's state with one row, anywhere in the town.

The arithmetic is plain float64 without fastmath, as in ``decide.py``. ``journey_geometry.py`` packs the geometry as
``packing.py`` describes, with all junction areas and all lanes of the town.
"""

import math
from typing import Any

import numpy as np

from wrongturn_judge import decide, kernels
from wrongturn_judge.compiling import compiled_with
from wrongturn_judge.decide import (
    COLLISION,
    D_FLAGS,
    D_RAN_OUT,
    D_VERDICT,
    KERB_BITE,
    LANE_INVASION,
    NOT_ENGAGED,
    NOT_LATER,
    OFF_ROAD,
    S_MIN_TTC,
    S_T,
    S_X,
    S_Y,
    STANDING_FLOATS,
    STANDING_INTS,
    TIMEOUT,
    WRONG_WAY,
    WRONG_WAY_FLAG,
)
from wrongturn_judge.kernels import (
    AREA_EDGE,
    CELL,
    EDGE,
    F_X,
    F_Y,
    I_APPROACH,
    I_APPROACH_COUNT,
    I_AREA_TABLE,
    I_AREAS,
    I_CELLS_X,
    I_CELLS_Y,
    I_EXITS,
    I_LANE_TABLE,
    N_WHEELS_OFF,
    NOT_FINITE,
    NUMBERS,
    Array,
    covers,
    least_contact,
    on_road,
    project,
    wheels_off,
)

ARRIVED = 13
"""Number of this verdict, in the vocabulary's order."""

# Places in the header; a journey's geometry has no approach, so it reuses that one's places.
I_CANDIDATES, I_WIDTH, I_ONWARD = I_APPROACH, I_APPROACH_COUNT, I_EXITS

# A journey's numbers come after those of every judge.
N_STOP_SPEED, N_WRONG_WAY_TIME, N_STAND_TIME, N_BACK_TIME = NUMBERS, NUMBERS + 1, NUMBERS + 2, NUMBERS + 3
JOURNEY_NUMBERS = NUMBERS + 4

# A journey's floats come after those of every state: since when the car stands (nan: it moves); since when the centre
# is in an oncoming lane (nan: it is not); when it was last off the road, and in an oncoming lane (-inf: never); metres
# driven; least metres left to the goal.
J_SLOW_SINCE, J_ONCOMING_SINCE, J_LAST_OFF, J_LAST_WRONG, J_DISTANCE, J_LEFT = range(
    STANDING_FLOATS, STANDING_FLOATS + 6
)
JOURNEY_FLOATS = STANDING_FLOATS + 6
# And its ints: the last lane that the centre was in and drove along (-1: none); the counts.
J_LANE, J_JUNCTIONS, J_OFF, J_WRONG = range(STANDING_INTS, STANDING_INTS + 4)
JOURNEY_INTS = STANDING_INTS + 4

# What ends a journey: its time limit; the goal's lane (-1: none) and metres along it; whether it is strict.
T_LIMIT, T_GOAL, T_AT, T_STRICT = 0, 1, 2, 3
TERMS = 4


@compiled_with(decide)
def begin(past: Array, ints: Array) -> None:
    """Set the state to that of a journey without rows."""
    decide.begin(past, ints)
    past[J_SLOW_SINCE] = past[J_ONCOMING_SINCE] = math.nan
    past[J_LAST_OFF] = past[J_LAST_WRONG] = -math.inf
    past[J_DISTANCE] = 0.0
    past[J_LEFT] = math.inf
    ints[J_LANE] = -1


@compiled_with(kernels)
def lane_at(floats: Array, ints: Array, cells: Array, lanes: Array, x: float, y: float) -> int:
    """Return the number of the lane that a point lies in; -1 in a junction's area and outside all lanes."""
    column = math.floor((x - floats[F_X]) / CELL)
    row = math.floor((y - floats[F_Y]) / CELL)
    if not (0 <= column < ints[I_CELLS_X] and 0 <= row < ints[I_CELLS_Y]):
        return -1
    cell = row * ints[I_CELLS_X] + column
    found: Any = np.int64(lanes[cell])
    if found == 0:
        return -1
    area: Any = (np.int64(cells[cell]) >> 2) & 3
    if area == AREA_EDGE:
        for k in range(ints[I_AREAS]):
            table = ints[I_AREA_TABLE] + 2 * k
            if covers(floats, ints[table], ints[table + 1], x, y):
                return -1
    elif area != 0:
        return -1
    if found > 0:
        return int(found - 1)
    width = ints[I_WIDTH]
    first = ints[I_CANDIDATES] - (found + 1) * width
    for i in range(first, first + width):
        lane = ints[i]
        if lane < 0:
            break
        table = ints[I_LANE_TABLE] + EDGE * lane
        if covers(floats, ints[table], ints[table + 1], x, y):
            return int(lane)
    return -1


@compiled_with(decide, kernels)
def observe(
    floats: Array, whole: Array, cells: Array, lanes: Array, numbers: Array, users: Array, terms: Array, rest: Array,
    standing: Array, ints: Array, t: float, x: float, y: float, yaw: float, v: float,
) -> int:  # fmt: skip
    """Take the next row.

    Args:
        floats: floats of the packed geometry.
        whole: ints of the packed geometry.
        cells: road and junction areas of each cell.
        lanes: lane of each cell.
        numbers: (JOURNEY_NUMBERS,), thresholds and body.
        users: (n, 6), the other road users at this row.
        terms: (TERMS,), what ends the journey.
        rest: metres from each lane's end to the start of the goal's lane, by the shortest way; unused without a goal.
        standing: (JOURNEY_FLOATS,), floats of the journey's state, changed.
        ints: (JOURNEY_INTS,), ints of the journey's state, changed.
        t: time of the row, s.
        x: metres.
        y: metres.
        yaw: radians.
        v: m/s.

    Returns:
        The verdict at this row, 0 for none; NOT_LATER or NOT_FINITE for a row that cannot be judged, which changes
        nothing.
    """
    if not t > standing[S_T]:
        return NOT_LATER
    if not math.isfinite(x + y + yaw + v):
        return NOT_FINITE
    c = math.cos(yaw)
    s = math.sin(yaw)
    if not math.isnan(standing[S_X]):
        dx = x - standing[S_X]
        dy = y - standing[S_Y]
        standing[J_DISTANCE] += math.sqrt(dx * dx + dy * dy)
    decide.keep(standing, t, x, y, v)
    if v >= numbers[N_STOP_SPEED]:
        standing[J_SLOW_SINCE] = math.nan
    elif math.isnan(standing[J_SLOW_SINCE]):
        standing[J_SLOW_SINCE] = t

    wheels = wheels_off(floats, whole, cells, numbers, x, y, c, s)
    off = wheels >= numbers[N_WHEELS_OFF] or not on_road(floats, whole, cells, x, y)
    if off:
        if t - standing[J_LAST_OFF] >= numbers[N_BACK_TIME]:
            ints[J_OFF] += 1
        standing[J_LAST_OFF] = t
    elif wheels:
        ints[D_FLAGS] |= KERB_BITE

    arrived = oncoming = False
    lane = lane_at(floats, whole, cells, lanes, x, y)
    if lane >= 0:
        table = whole[I_LANE_TABLE] + 4 * lane
        along, _, ux, uy = project(floats, whole[table + 2], whole[table + 3], x, y)
        oncoming = c * ux + s * uy < 0.0
        if not oncoming:
            before = ints[J_LANE]
            if lane != before:
                if before >= 0:
                    for k in range(3):
                        if whole[whole[I_ONWARD] + 3 * before + k] == lane:
                            ints[J_JUNCTIONS] += 1
                            break
                ints[J_LANE] = lane
            goal = int(terms[T_GOAL])
            if goal >= 0:
                if lane == goal and along >= terms[T_AT]:
                    arrived = True
                    standing[J_LEFT] = 0.0
                else:
                    left = terms[T_AT] - along
                    if lane != goal:
                        last = whole[table + 2] + 6 * (whole[table + 3] - 1)
                        left += floats[last + 5] + floats[last + 4] + rest[lane]
                    standing[J_LEFT] = min(standing[J_LEFT], left)
    if oncoming:
        ints[D_FLAGS] |= LANE_INVASION
        if math.isnan(standing[J_ONCOMING_SINCE]):
            standing[J_ONCOMING_SINCE] = t
        if t - standing[J_LAST_WRONG] >= numbers[N_BACK_TIME]:
            ints[J_WRONG] += 1
        standing[J_LAST_WRONG] = t
    else:
        standing[J_ONCOMING_SINCE] = math.nan

    time = least_contact(floats, whole, numbers, users, x, y, c, s, v)
    hit = time < 0.0
    if hit:
        time = 0.0
    if time < standing[S_MIN_TTC]:  # noqa: PLR1730
        standing[S_MIN_TTC] = time

    verdict = 0
    strict = terms[T_STRICT] != 0.0
    if hit:
        verdict = COLLISION
    elif strict and off:
        verdict = OFF_ROAD
    elif strict and t - standing[J_ONCOMING_SINCE] >= numbers[N_WRONG_WAY_TIME]:  # False for nan
        verdict = WRONG_WAY
        ints[D_FLAGS] |= WRONG_WAY_FLAG
    elif strict and t - standing[J_SLOW_SINCE] >= numbers[N_STAND_TIME]:
        verdict = NOT_ENGAGED
    elif arrived:
        verdict = ARRIVED
    elif t >= terms[T_LIMIT]:
        verdict = TIMEOUT
        ints[D_RAN_OUT] = 1
    ints[D_VERDICT] = verdict
    return verdict
