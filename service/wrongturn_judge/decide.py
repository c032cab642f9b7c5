"""The judge's decision, compiled: it updates an episode's state with one row of the trajectory.

The state of an episode is a STATE. Its *history* has a MOMENT for each row of the trajectory, which tells how far the
car moved in the last seconds. A :class:`~wrongturn_judge.judges.Judge` keeps one of each; a fleet keeps one for each
car. The arithmetic is plain float64 without fastmath, as in ``kernels.py``.
"""

import math
from typing import Any

from wrongturn_judge import kernels
from wrongturn_judge.compiling import compiled, record
from wrongturn_judge.kernels import NOT_FINITE, Array, Ground, box_meets, inspect_row, nose_past

STATE = record(
    "t x y v min_ttc max_deceleration driven area rest kerb_m kerb_s opposed_m over_line first_stop "
    "slow_since oncoming_since last_off last_wrong left",
    "zone delivered past heard flags ran_out verdict direction rows stand at_rest wait counted "
    "lane junctions off wrong",
)
"""The last row; the extremes so far; metres driven. Of a junction: seconds in its area, and at rest there; metres and
seconds of kerb bites; metres on opposed lanes; metres that a stopped car's nose is past the line; when the car first
stood (both nan: it did not). Of a journey: since when the car stands (nan: it moves), and since when the centre is in
an oncoming lane (nan: it is not); when it was last off the road, and in an oncoming lane (-inf: never); least metres
left to the goal.

The zone; the last direction that was delivered; a bit for each exit that the car was too far past for later commands to
count, and in two bits each the direction that was delivered last before that (0: none was); flags; whether the time ran
out; the verdict; the exit's direction; the number of rows; the first rows from which the car moved less than it may to
stand, to be at rest, and to wait; the row up to which time at rest is counted. Of a journey: the last lane that the
centre was in and drove along (-1: none); the counts."""
MOMENT = record("t driven area")
"""Time, metres driven, seconds in the junction's area."""

AHEAD, NEAR, INSIDE, BEYOND = 0, 1, 2, 3
"""Zones: the centre never came near the stop line; it did; it is in the junction's area; it was, and has left it."""
KERB_BITE, LANE_INVASION, WRONG_WAY_FLAG, OPPOSED_LANE = 1, 2, 4, 8
"""Bits of the flags. Journeys set the first three."""
BODY_OVER = 1 << 10
"""Bit of a row, beside those of ``inspect_row``: the body is over the junction's area."""

# Numbers of the verdicts, in the vocabulary's order; 0 is none yet.
COLLISION, OFF_ROAD, STOPPED_IN_JUNCTION, WRONG_WAY, UNFINISHED, STOPPED_BEFORE_JUNCTION = 1, 2, 3, 4, 5, 6
EXIT_COMMANDED, EXIT_ROUTE, EXIT_OTHER, TIMEOUT, NOT_ENGAGED, ABORTED = 7, 8, 9, 10, 11, 12
NOT_LATER = -2
"""Result for a row that is not later than the one before."""
FULL = -3
"""Result when the history has no room for another row."""


@compiled()
def begin(row: Array) -> None:
    """Set a STATE to that of an episode without rows."""
    row[:] = 0.0
    state = row.view(STATE)[0]
    state.t = state.last_off = state.last_wrong = -math.inf
    state.x = state.y = state.over_line = state.first_stop = math.nan
    state.slow_since = state.oncoming_since = math.nan
    state.min_ttc = state.left = math.inf
    state.lane = -1


@compiled()
def keep(state: Any, t: float, x: float, y: float, v: float) -> None:
    """Keep a row as the last one, and the greatest deceleration."""
    deceleration = (state.v - v) / (t - state.t)
    if deceleration > state.max_deceleration:  # noqa: PLR1730  max() may give -0.0
        state.max_deceleration = deceleration
    state.t, state.x, state.y, state.v = t, x, y, v


@compiled()
def zone_after(zone: int, bits: int) -> int:
    """Return the zone of a row that follows one in ``zone``."""
    if bits & kernels.IN_AREA:
        return INSIDE
    if zone >= INSIDE:
        return BEYOND
    return NEAR if bits & kernels.ENGAGED else zone


@compiled()
def hear(state: Any, bits: int, command: int) -> None:
    """Keep the last direction that was delivered, and for each exit the last one that counts."""
    if 1 <= command <= 3:
        state.delivered = command
    past = bits >> kernels.PAST_SHIFT & 0b111 & ~state.past
    if past:
        for k in range(3):
            if past >> k & 1:
                state.heard |= state.delivered << 2 * k
        state.past |= past


@compiled()
def harm(numbers: Any, bits: int) -> int:
    """Return the verdict of a row at which the car hit something or left the road; 0 if it did neither."""
    if bits & kernels.HIT:
        return COLLISION
    if bits & kernels.CENTRE_OFF or (bits & kernels.WHEELS) >= numbers.wheels_off:
        return OFF_ROAD
    return 0


@compiled()
def exit_taken(state: Any, route: int, bits: int) -> int:
    """Return the verdict of a row at which the car took an exit, and keep which; 0 if it took none."""
    for k in range(3):
        if bits >> (kernels.TAKEN_SHIFT + k) & 1:
            direction = k + 1
            state.direction = direction
            delivered = state.heard >> 2 * k & 0b11 if state.past >> k & 1 else state.delivered
            if delivered == direction:
                return EXIT_COMMANDED
            return EXIT_ROUTE if direction == route else EXIT_OTHER
    return 0


@compiled()
def slow_since(history: Array, row: int, first: int, distance: float) -> int:
    """Return the first row, at or after ``first``, since which the centre moved less than a distance."""
    while history[row].driven - history[first].driven >= distance:
        first += 1
    return first


@compiled()
def measure(numbers: Any, state: Any, history: Array, t: float, metres: float, bits: int) -> None:
    """Add the way and the time from the row before to this one to all lengths, durations and sums."""
    row = state.rows
    seconds = t - state.t if row > 0 else 0.0
    state.driven += metres
    if bits & kernels.IN_AREA:
        state.area += seconds
    if 1 <= (bits & kernels.WHEELS) < numbers.wheels_off:
        state.kerb_m += metres
        state.kerb_s += seconds
    if bits & kernels.OPPOSED:
        state.opposed_m += metres
        if state.opposed_m > numbers.opposed_distance:
            state.flags |= OPPOSED_LANE
    history[row].t = t
    history[row].driven = state.driven
    history[row].area = state.area
    state.rows = row + 1

    state.wait = slow_since(history, row, state.wait, numbers.wait_distance)
    stand = slow_since(history, row, state.stand, numbers.stand_distance)
    state.stand = stand
    if math.isnan(state.first_stop) and t - history[stand].t >= numbers.stand_time:
        state.first_stop = history[stand].t
    rest = slow_since(history, row, state.at_rest, numbers.rest_distance)
    state.at_rest = rest
    if t - history[rest].t >= numbers.rest_time:
        # The car is at rest: count the last second, as far as it is not counted yet and was spent in the area.
        first = row
        while first > state.counted and t - history[first].t < numbers.rest_time:
            first -= 1
        state.rest += history[row].area - history[first].area
        state.counted = row


@compiled()
def decide(state: Any, numbers: Any, history: Array, route: int, bits: int) -> int:
    """Return the first verdict in the table's order that holds at this row; 0 if none does."""
    verdict = harm(numbers, bits)
    if verdict:
        return verdict
    t = state.t
    time_is_out = t >= numbers.time_limit
    zone = state.zone
    if zone == INSIDE and (
        t - history[state.stand].t >= numbers.stand_time
        or state.rest >= numbers.rest_total
        or state.area >= numbers.area_total
    ):
        return STOPPED_IN_JUNCTION
    if zone == BEYOND:
        # A wrong way is one without an exit, so an exit that is reached at the same instant comes first.
        verdict = exit_taken(state, route, bits)
        if verdict:
            return verdict
        if bits & (kernels.FAR | kernels.IN_OTHER):
            return WRONG_WAY
    waited = t - history[state.wait].t
    if zone <= NEAR and waited >= numbers.wait_time:
        return STOPPED_BEFORE_JUNCTION if zone == NEAR else NOT_ENGAGED
    if not time_is_out:
        return 0
    state.ran_out = 1
    if zone == INSIDE or (zone == BEYOND and bits & (kernels.OPPOSED | BODY_OVER)):
        return WRONG_WAY
    if zone == NEAR and waited >= numbers.last_wait_time:
        return STOPPED_BEFORE_JUNCTION
    return NOT_ENGAGED if zone == AHEAD else TIMEOUT


@compiled()
def observe(
    head: Array, floats: Array, ints: Array, cells: Array, numbers: Array, users: Array, row: Array, history: Array,
    route: int, t: float, x: float, y: float, yaw: float, v: float, command: int,
) -> int:  # fmt: skip
    """Take the next row: place and heading (metres, radians), speed (m/s), and the command that the agent got.

    The first four are the packed geometry; ``numbers`` is a row of NUMBERS; ``users`` (n, 6) are the other road users;
    ``row`` is a STATE and ``history`` (rows, words) has a MOMENT for each row; both change. ``route`` is the trial's
    direction, 1 to 3.

    Returns:
        The verdict at this row, 0 for none. NOT_LATER or NOT_FINITE for a row that cannot be judged, and FULL for one
        for which the history has no room; these change nothing.
    """
    state = row.view(STATE)[0]
    if not t > state.t:
        return NOT_LATER
    if state.rows >= history.shape[0]:
        return FULL
    ground, limits = Ground(head.view(kernels.HEAD), floats, ints, cells), numbers.view(kernels.NUMBERS)[0]
    moments = history.view(MOMENT)[:, 0]
    zone = state.zone
    bits, ttc = inspect_row(ground, limits, users, x, y, yaw, v, zone >= INSIDE)
    if bits < 0:
        return NOT_FINITE
    metres = 0.0
    if state.rows > 0:
        dx = x - state.x
        dy = y - state.y
        metres = math.sqrt(dx * dx + dy * dy)
    measure(limits, state, moments, t, metres, bits)
    keep(state, t, x, y, v)
    if ttc < state.min_ttc:  # noqa: PLR1730
        state.min_ttc = ttc
    zone = zone_after(zone, bits)
    state.zone = zone
    hear(state, bits, command)
    if zone == BEYOND and t >= limits.time_limit:
        area = ground.head[0].area_table
        half_length, half_width = limits.half_length, limits.half_width
        if box_meets(floats, ints[area], ints[area + 1], x, y, math.cos(yaw), math.sin(yaw), half_length, half_width):
            bits |= BODY_OVER
    verdict = decide(state, limits, moments, route, bits)
    if verdict == STOPPED_BEFORE_JUNCTION:
        state.over_line = max(nose_past(ground.head[0], limits, x, y, math.cos(yaw), math.sin(yaw)), 0.0)
    if verdict and bits & kernels.OPPOSED:
        state.flags |= OPPOSED_LANE
    state.verdict = verdict
    return verdict
