"""The judge's decision, compiled: it updates an episode's state with one row of the trajectory.

The state (*standing*) of an episode is an array of floats and one of ints. A
:class:`~wrongturn_sim.verdict.judge.Judge` keeps one; a fleet keeps one row for each car. The arithmetic is plain
float64 without fastmath, as in ``kernels.py``.
"""

import math
from typing import Any

import numpy as np
from numba import njit

from wrongturn_sim.compiling import compiled_with
from wrongturn_sim.verdict import kernels
from wrongturn_sim.verdict.kernels import (
    CENTRE_OFF,
    ENGAGED,
    FAR,
    HIT,
    IN_AREA,
    IN_OTHER,
    INVASION,
    N_STOP_SPEED,
    N_STOP_TIME,
    N_TIME_LIMIT,
    N_WHEELS_OFF,
    NOSE_OVER,
    NOT_FINITE,
    PAST_SHIFT,
    TAKEN_SHIFT,
    WHEELS,
    inspect_row,
)

Array = np.ndarray[Any, Any]

# Floats of the state: the last row; since when the car stands (nan: it moves); the extremes so far.
S_T, S_X, S_Y, S_V, S_SLOW_SINCE, S_MIN_TTC, S_MAX_DECELERATION = 0, 1, 2, 3, 4, 5, 6
STANDING_FLOATS = 7

# Ints of the state. D_FOR takes three, in the order of DIRECTIONS: the direction that was delivered last when the car
# was too far past that exit for later commands to count (0: none was delivered; -1: not that far yet).
D_ZONE, D_DELIVERED, D_PAST, D_FOR, D_FLAGS, D_RAN_OUT, D_VERDICT, D_DIRECTION = 0, 1, 2, 3, 6, 7, 8, 9
STANDING_INTS = 10

AHEAD, NEAR, INSIDE, BEYOND = 0, 1, 2, 3
"""Zones: the centre never came near the stop line; it did; it is in the junction's area; it was, and has left it."""
KERB_BITE, LANE_INVASION, WRONG_WAY_FLAG, OVER_LINE = 1, 2, 4, 8
"""Bits of the flags."""

# Numbers of the verdicts, in the vocabulary's order; 0 is none yet.
COLLISION, OFF_ROAD, STOPPED_IN_JUNCTION, WRONG_WAY, STOPPED_BEFORE_JUNCTION = 1, 2, 3, 4, 5
EXIT_COMMANDED, EXIT_ROUTE, EXIT_OTHER, TIMEOUT, NOT_ENGAGED, ABORTED = 6, 7, 8, 9, 10, 11
NOT_LATER = -2
"""Result for a row that is not later than the one before."""

_NOTABLE = CENTRE_OFF | HIT | INVASION | WHEELS
_DECISIVE = CENTRE_OFF | HIT | WHEELS | FAR | IN_OTHER | (0b111 << TAKEN_SHIFT)


@njit(cache=True)
def begin(past: Array, ints: Array) -> None:
    """Set the state to that of an episode without rows."""
    past[S_T] = -math.inf
    past[S_X] = past[S_Y] = past[S_SLOW_SINCE] = math.nan
    past[S_V] = past[S_MAX_DECELERATION] = 0.0
    past[S_MIN_TTC] = math.inf
    ints[:] = 0
    ints[D_FOR] = ints[D_FOR + 1] = ints[D_FOR + 2] = -1


@compiled_with(kernels)
def decide(standing: Array, ints: Array, numbers: Array, route: int, bits: int) -> int:
    """Return the first verdict in the table's order that holds at this row; 0 if none does."""
    if bits & HIT:
        return COLLISION
    if bits & CENTRE_OFF or (bits & WHEELS) >= numbers[N_WHEELS_OFF]:
        return OFF_ROAD
    t = standing[S_T]
    time_is_out = t >= numbers[N_TIME_LIMIT]
    stopped = t - standing[S_SLOW_SINCE] >= numbers[N_STOP_TIME]  # False for a car that moves: nan
    zone = ints[D_ZONE]
    if zone == INSIDE and (stopped or time_is_out):
        ints[D_RAN_OUT] = 0 if stopped else 1
        return STOPPED_IN_JUNCTION
    if zone == BEYOND:
        for k in range(3):
            if bits >> (TAKEN_SHIFT + k) & 1:
                direction = k + 1
                ints[D_DIRECTION] = direction
                delivered = ints[D_FOR + k] if ints[D_FOR + k] >= 0 else ints[D_DELIVERED]
                if delivered == direction:
                    return EXIT_COMMANDED
                return EXIT_ROUTE if direction == route else EXIT_OTHER
        # A wrong way is one without an exit, so an exit that is reached at the same instant comes first.
        if bits & (FAR | IN_OTHER):
            return WRONG_WAY
    if stopped and zone == NEAR:
        return STOPPED_BEFORE_JUNCTION
    if stopped and zone == AHEAD:
        return NOT_ENGAGED
    if time_is_out:
        ints[D_RAN_OUT] = 1
        return NOT_ENGAGED if zone == AHEAD else TIMEOUT
    return 0


@compiled_with(kernels)
def observe(
    floats: Array, whole: Array, cells: Array, numbers: Array, users: Array, standing: Array, ints: Array, route: int,
    t: float, x: float, y: float, yaw: float, v: float, command: int,
) -> int:  # fmt: skip
    """Take the next row.

    Args:
        floats: floats of the packed geometry.
        whole: ints of the packed geometry.
        cells: cells of the packed geometry.
        numbers: thresholds and body, as ``packing.numbers_of`` returns them.
        users: (n, 6), the other road users at this row.
        standing: floats of the episode's state, changed.
        ints: ints of the episode's state, changed.
        route: the trial's direction, 1 to 3.
        t: time of the row, s.
        x: metres.
        y: metres.
        yaw: radians.
        v: m/s.
        command: the command that the agent got.

    Returns:
        The verdict at this row, 0 for none; NOT_LATER or NOT_FINITE for a row that cannot be judged, which changes
        nothing.
    """
    if not t > standing[S_T]:
        return NOT_LATER
    zone = ints[D_ZONE]
    entered = zone >= INSIDE
    bits, ttc = inspect_row(floats, whole, cells, numbers, users, x, y, yaw, v, entered)
    if bits < 0:
        return NOT_FINITE
    deceleration = (standing[S_V] - v) / (t - standing[S_T])
    if deceleration > standing[S_MAX_DECELERATION]:  # noqa: PLR1730  max() may give -0.0
        standing[S_MAX_DECELERATION] = deceleration
    standing[S_T] = t
    standing[S_X] = x
    standing[S_Y] = y
    standing[S_V] = v
    if ttc < standing[S_MIN_TTC]:  # noqa: PLR1730
        standing[S_MIN_TTC] = ttc

    if bits & IN_AREA:
        zone = INSIDE
    elif entered:
        zone = BEYOND
    elif bits & ENGAGED:
        zone = NEAR
    if v >= numbers[N_STOP_SPEED]:
        standing[S_SLOW_SINCE] = math.nan
    elif math.isnan(standing[S_SLOW_SINCE]) or zone != ints[D_ZONE]:
        standing[S_SLOW_SINCE] = t
    ints[D_ZONE] = zone

    if 1 <= command <= 3:
        ints[D_DELIVERED] = command
    past = bits >> PAST_SHIFT & 0b111 & ~ints[D_PAST]
    if past:
        for k in range(3):
            if past >> k & 1:
                ints[D_FOR + k] = ints[D_DELIVERED]
        ints[D_PAST] |= past
    if bits & _NOTABLE:
        if 1 <= (bits & WHEELS) < numbers[N_WHEELS_OFF]:
            ints[D_FLAGS] |= KERB_BITE
        if bits & INVASION:
            ints[D_FLAGS] |= LANE_INVASION
    if not bits & _DECISIVE and math.isnan(standing[S_SLOW_SINCE]) and t < numbers[N_TIME_LIMIT]:
        return 0  # no verdict can hold; this is so for nearly every row
    verdict = decide(standing, ints, numbers, route, bits)
    if verdict == WRONG_WAY:
        ints[D_FLAGS] |= WRONG_WAY_FLAG
    if verdict == STOPPED_BEFORE_JUNCTION and bits & NOSE_OVER:
        ints[D_FLAGS] |= OVER_LINE
    ints[D_VERDICT] = verdict
    return verdict
