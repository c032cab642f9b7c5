"""The judge's decision, compiled: it updates an episode's state with one row of the trajectory.

The state (*standing*) of an episode is an array of floats, one of ints, and the *history*: a row for each row of the
trajectory, from which the judge tells how far the car moved in the last seconds. A
:class:`~wrongturn_judge.judges.Judge` keeps one; a fleet keeps one for each car. The arithmetic is plain float64
without fastmath, as in ``kernels.py``.
"""

import math

from numba import njit

from wrongturn_judge import kernels
from wrongturn_judge.compiling import compiled_with
from wrongturn_judge.kernels import (
    CENTRE_OFF,
    ENGAGED,
    FAR,
    HIT,
    I_AREA_TABLE,
    IN_AREA,
    IN_OTHER,
    N_AREA_TOTAL,
    N_HALF_LENGTH,
    N_HALF_WIDTH,
    N_LAST_WAIT_TIME,
    N_OPPOSED_DISTANCE,
    N_REST_DISTANCE,
    N_REST_TIME,
    N_REST_TOTAL,
    N_STAND_DISTANCE,
    N_STAND_TIME,
    N_TIME_LIMIT,
    N_WAIT_DISTANCE,
    N_WAIT_TIME,
    N_WHEELS_OFF,
    NOT_FINITE,
    OPPOSED,
    PAST_SHIFT,
    TAKEN_SHIFT,
    WHEELS,
    Array,
    box_meets,
    inspect_row,
    nose_past,
)

# Floats of every state: the last row, and the extremes so far.
S_T, S_X, S_Y, S_V, S_MIN_TTC, S_MAX_DECELERATION = 0, 1, 2, 3, 4, 5
# Floats of a junction: metres driven; seconds in the junction's area, and at rest there; metres and seconds of kerb
# bites; metres on opposed lanes; metres that a stopped car's nose is past the line; when the car first stood (both nan:
# it did not).
S_DRIVEN, S_AREA, S_REST, S_KERB_M, S_KERB_S, S_OPPOSED_M, S_OVER_LINE, S_FIRST_STOP = 6, 7, 8, 9, 10, 11, 12, 13
STANDING_FLOATS = 14

# Ints of the state. D_FOR takes three, in the order of DIRECTIONS: the direction that was delivered last when the car
# was too far past that exit for later commands to count (0: none was delivered; -1: not that far yet).
D_ZONE, D_DELIVERED, D_PAST, D_FOR, D_FLAGS, D_RAN_OUT, D_VERDICT, D_DIRECTION = 0, 1, 2, 3, 6, 7, 8, 9
# The number of rows; the first rows from which the car moved less than it may to stand, to be at rest, and to wait; and
# the row up to which time at rest is counted.
D_ROWS, D_STAND, D_AT_REST, D_WAIT, D_COUNTED = 10, 11, 12, 13, 14
STANDING_INTS = 15

H_T, H_DRIVEN, H_AREA = 0, 1, 2
"""Columns of the history: time, metres driven, seconds in the junction's area."""
HISTORY = 3

AHEAD, NEAR, INSIDE, BEYOND = 0, 1, 2, 3
"""Zones: the centre never came near the stop line; it did; it is in the junction's area; it was, and has left it."""
KERB_BITE, LANE_INVASION, WRONG_WAY_FLAG, OPPOSED_LANE = 1, 2, 4, 8
"""Bits of the flags. Journeys set the first three."""
BODY_OVER = 1 << 10
"""Bit of a row, beside those of ``inspect_row``: the body is over the junction's area."""

# Numbers of the verdicts, in the vocabulary's order; 0 is none yet.
COLLISION, OFF_ROAD, STOPPED_IN_JUNCTION, WRONG_WAY, STOPPED_BEFORE_JUNCTION = 1, 2, 3, 4, 5
EXIT_COMMANDED, EXIT_ROUTE, EXIT_OTHER, TIMEOUT, NOT_ENGAGED, ABORTED = 6, 7, 8, 9, 10, 11
NOT_LATER = -2
"""Result for a row that is not later than the one before."""
FULL = -3
"""Result when the history has no room for another row."""


@njit(cache=True)
def begin(past: Array, ints: Array) -> None:
    """Set the state to that of an episode without rows."""
    past[:STANDING_FLOATS] = 0.0
    past[S_T] = -math.inf
    past[S_X] = past[S_Y] = past[S_OVER_LINE] = past[S_FIRST_STOP] = math.nan
    past[S_MIN_TTC] = math.inf
    ints[:] = 0
    ints[D_FOR] = ints[D_FOR + 1] = ints[D_FOR + 2] = -1


@njit(cache=True)
def keep(standing: Array, t: float, x: float, y: float, v: float) -> None:
    """Keep a row as the last one, and the greatest deceleration."""
    deceleration = (standing[S_V] - v) / (t - standing[S_T])
    if deceleration > standing[S_MAX_DECELERATION]:  # noqa: PLR1730  max() may give -0.0
        standing[S_MAX_DECELERATION] = deceleration
    standing[S_T] = t
    standing[S_X] = x
    standing[S_Y] = y
    standing[S_V] = v


@compiled_with(kernels)
def zone_after(zone: int, bits: int) -> int:
    """Return the zone of a row that follows one in ``zone``."""
    if bits & IN_AREA:
        return INSIDE
    if zone >= INSIDE:
        return BEYOND
    return NEAR if bits & ENGAGED else zone


@compiled_with(kernels)
def hear(ints: Array, bits: int, command: int) -> None:
    """Keep the last direction that was delivered, and for each exit the last one that counts."""
    if 1 <= command <= 3:
        ints[D_DELIVERED] = command
    past = bits >> PAST_SHIFT & 0b111 & ~ints[D_PAST]
    if past:
        for k in range(3):
            if past >> k & 1:
                ints[D_FOR + k] = ints[D_DELIVERED]
        ints[D_PAST] |= past


@compiled_with(kernels)
def harm(numbers: Array, bits: int) -> int:
    """Return the verdict of a row at which the car hit something or left the road; 0 if it did neither."""
    if bits & HIT:
        return COLLISION
    if bits & CENTRE_OFF or (bits & WHEELS) >= numbers[N_WHEELS_OFF]:
        return OFF_ROAD
    return 0


@compiled_with(kernels)
def exit_taken(ints: Array, route: int, bits: int) -> int:
    """Return the verdict of a row at which the car took an exit, and keep which; 0 if it took none."""
    for k in range(3):
        if bits >> (TAKEN_SHIFT + k) & 1:
            direction = k + 1
            ints[D_DIRECTION] = direction
            delivered = ints[D_FOR + k] if ints[D_FOR + k] >= 0 else ints[D_DELIVERED]
            if delivered == direction:
                return EXIT_COMMANDED
            return EXIT_ROUTE if direction == route else EXIT_OTHER
    return 0


@njit(cache=True)
def slow_since(history: Array, row: int, first: int, distance: float) -> int:
    """Return the first row, at or after ``first``, since which the centre moved less than a distance."""
    while history[row, H_DRIVEN] - history[first, H_DRIVEN] >= distance:
        first += 1
    return first


@compiled_with(kernels)
def measure(numbers: Array, standing: Array, ints: Array, history: Array, t: float, metres: float, bits: int) -> None:
    """Add the way and the time from the row before to this one to all lengths, durations and sums."""
    row = ints[D_ROWS]
    seconds = t - standing[S_T] if row > 0 else 0.0
    standing[S_DRIVEN] += metres
    if bits & IN_AREA:
        standing[S_AREA] += seconds
    if 1 <= (bits & WHEELS) < numbers[N_WHEELS_OFF]:
        standing[S_KERB_M] += metres
        standing[S_KERB_S] += seconds
    if bits & OPPOSED:
        standing[S_OPPOSED_M] += metres
        if standing[S_OPPOSED_M] > numbers[N_OPPOSED_DISTANCE]:
            ints[D_FLAGS] |= OPPOSED_LANE
    history[row, H_T] = t
    history[row, H_DRIVEN] = standing[S_DRIVEN]
    history[row, H_AREA] = standing[S_AREA]
    ints[D_ROWS] = row + 1

    ints[D_WAIT] = slow_since(history, row, ints[D_WAIT], numbers[N_WAIT_DISTANCE])
    stand = slow_since(history, row, ints[D_STAND], numbers[N_STAND_DISTANCE])
    ints[D_STAND] = stand
    if math.isnan(standing[S_FIRST_STOP]) and t - history[stand, H_T] >= numbers[N_STAND_TIME]:
        standing[S_FIRST_STOP] = history[stand, H_T]
    rest = slow_since(history, row, ints[D_AT_REST], numbers[N_REST_DISTANCE])
    ints[D_AT_REST] = rest
    if t - history[rest, H_T] >= numbers[N_REST_TIME]:
        # The car is at rest: count the last second, as far as it is not counted yet and was spent in the area.
        first = row
        while first > ints[D_COUNTED] and t - history[first, H_T] < numbers[N_REST_TIME]:
            first -= 1
        standing[S_REST] += history[row, H_AREA] - history[first, H_AREA]
        ints[D_COUNTED] = row


@compiled_with(kernels)
def decide(standing: Array, ints: Array, numbers: Array, history: Array, route: int, bits: int) -> int:
    """Return the first verdict in the table's order that holds at this row; 0 if none does."""
    verdict = harm(numbers, bits)
    if verdict:
        return verdict
    t = standing[S_T]
    time_is_out = t >= numbers[N_TIME_LIMIT]
    zone = ints[D_ZONE]
    if zone == INSIDE and (
        t - history[ints[D_STAND], H_T] >= numbers[N_STAND_TIME]
        or standing[S_REST] >= numbers[N_REST_TOTAL]
        or standing[S_AREA] >= numbers[N_AREA_TOTAL]
    ):
        return STOPPED_IN_JUNCTION
    if zone == BEYOND:
        # A wrong way is one without an exit, so an exit that is reached at the same instant comes first.
        verdict = exit_taken(ints, route, bits)
        if verdict:
            return verdict
        if bits & (FAR | IN_OTHER):
            return WRONG_WAY
    waited = t - history[ints[D_WAIT], H_T]
    if zone <= NEAR and waited >= numbers[N_WAIT_TIME]:
        return STOPPED_BEFORE_JUNCTION if zone == NEAR else NOT_ENGAGED
    if not time_is_out:
        return 0
    ints[D_RAN_OUT] = 1
    if zone == INSIDE or (zone == BEYOND and bits & (OPPOSED | BODY_OVER)):
        return WRONG_WAY
    if zone == NEAR and waited >= numbers[N_LAST_WAIT_TIME]:
        return STOPPED_BEFORE_JUNCTION
    return NOT_ENGAGED if zone == AHEAD else TIMEOUT


@compiled_with(kernels)
def observe(
    floats: Array, whole: Array, cells: Array, numbers: Array, users: Array, standing: Array, ints: Array,
    history: Array, route: int, t: float, x: float, y: float, yaw: float, v: float, command: int,
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
        history: (rows, HISTORY), changed.
        route: the trial's direction, 1 to 3.
        t: time of the row, s.
        x: metres.
        y: metres.
        yaw: radians.
        v: m/s.
        command: the command that the agent got.

    Returns:
        The verdict at this row, 0 for none. NOT_LATER or NOT_FINITE for a row that cannot be judged, and FULL for one
        for which the history has no room; these change nothing.
    """
    if not t > standing[S_T]:
        return NOT_LATER
    if ints[D_ROWS] >= history.shape[0]:
        return FULL
    zone = ints[D_ZONE]
    bits, ttc = inspect_row(floats, whole, cells, numbers, users, x, y, yaw, v, zone >= INSIDE)
    if bits < 0:
        return NOT_FINITE
    metres = 0.0
    if ints[D_ROWS] > 0:
        dx = x - standing[S_X]
        dy = y - standing[S_Y]
        metres = math.sqrt(dx * dx + dy * dy)
    measure(numbers, standing, ints, history, t, metres, bits)
    keep(standing, t, x, y, v)
    if ttc < standing[S_MIN_TTC]:  # noqa: PLR1730
        standing[S_MIN_TTC] = ttc
    zone = zone_after(zone, bits)
    ints[D_ZONE] = zone
    hear(ints, bits, command)
    if zone == BEYOND and t >= numbers[N_TIME_LIMIT]:
        area = whole[I_AREA_TABLE]
        half_length, half_width = numbers[N_HALF_LENGTH], numbers[N_HALF_WIDTH]
        if box_meets(floats, whole[area], whole[area + 1], x, y, math.cos(yaw), math.sin(yaw), half_length, half_width):
            bits |= BODY_OVER
    verdict = decide(standing, ints, numbers, history, route, bits)
    if verdict == STOPPED_BEFORE_JUNCTION:
        standing[S_OVER_LINE] = max(nose_past(floats, numbers, x, y, math.cos(yaw), math.sin(yaw)), 0.0)
    if verdict and bits & OPPOSED:
        ints[D_FLAGS] |= OPPOSED_LANE
    ints[D_VERDICT] = verdict
    return verdict
