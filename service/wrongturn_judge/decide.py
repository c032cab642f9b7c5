"""The judge's decision, compiled: it updates an episode's state with one row of the trajectory.

The state of an episode is a STATE. Its *history* has a MOMENT for each row of the trajectory, which tells how far the
car moved in the last seconds. A :class:`~wrongturn_judge.judges.Judge` keeps one of each; a fleet keeps one for each
car. The arithmetic is plain float64 without fastmath, as in ``kernels.py``.
"""

import math
from typing import Any

from wrongturn_judge import kernels
from wrongturn_judge.compiling import compiled, record
from wrongturn_judge.kernels import NOT_FINITE, Array, Ground, inspect_row, nose_past, project
from wrongturn_judge.motion import curvature_of, moved, turn_between

STATE = record(
    "t x y yaw v min_ttc_users min_ttc_solids max_deceleration driven area rest turned exit_t "
    "kerb_m kerb_s opposed_m past_line first_stop slow_since oncoming_since last_off last_wrong left",
    "zone delivered past heard flags ran_out verdict exit direction rows stand at_rest wait counted "
    "lane junctions off wrong",
)
"""The last row; the extremes so far; metres driven. Of a junction: seconds over its area, and at rest there; radians
turned there; when the exit was taken; metres and seconds of kerb bites; metres on opposed lanes; metres that a stopped
car's nose is past the line; when the car first stood (both nan: it did not). Of a journey: since when the car stands
(nan: it moves), and since when the centre is in an oncoming lane (nan: it is not); when it was last off the road, and
in an oncoming lane (-inf: never); least metres left to the goal.

The zone; the last direction that was delivered; a bit for each exit that the car was too far past for later commands to
count, and in two bits each the direction that was delivered last before that (0: none was); flags; whether the time ran
out; the verdict; the verdict of the exit that was taken (0: none), and its direction; the number of rows; the first
rows from which the car moved less than it may to stand, to be at rest, and to wait; the row up to which time at rest is
counted. Of a journey: the last lane that the centre was in and drove along (-1: none); the counts."""
MOMENT = record("t driven area")
"""Time, metres driven, seconds over the junction's area."""

AHEAD, NEAR, OVER, BEYOND = 0, 1, 2, 3
"""Zones: the centre never came near the stop line; it did; the centre is in the junction's area, or was there and a
part of the body is; all of the body has left it."""
KERB_BITE, LANE_INVASION, WRONG_WAY_FLAG, OPPOSED_LANE, STOPPED_ACROSS, SPEEDING, KERB_RIDE = 1, 2, 4, 8, 16, 32, 64
"""Bits of the flags. Journeys set the first three."""
AHEAD_STEP = 0.05
"""Time step of the second that follows a watched drive, s."""

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
    state.x = state.y = state.past_line = state.first_stop = math.nan
    state.slow_since = state.oncoming_since = math.nan
    state.min_ttc_users = state.min_ttc_solids = state.left = math.inf
    state.lane = -1


@compiled()
def keep(state: Any, t: float, x: float, y: float, yaw: float, v: float, users: float, solids: float) -> None:
    """Keep a row as the last one, the greatest deceleration, and the least times to contact with users and solids."""
    deceleration = (state.v - v) / (t - state.t)
    if deceleration > state.max_deceleration:  # noqa: PLR1730  max() may give -0.0
        state.max_deceleration = deceleration
    if users < state.min_ttc_users:  # noqa: PLR1730
        state.min_ttc_users = users
    if solids < state.min_ttc_solids:  # noqa: PLR1730
        state.min_ttc_solids = solids
    state.t, state.x, state.y, state.yaw, state.v = t, x, y, yaw, v


@compiled()
def zone_after(zone: int, bits: int) -> int:
    """Return the zone of a row that follows one in ``zone``."""
    if bits & kernels.IN_AREA:
        return OVER
    if zone >= OVER:
        return OVER if bits & kernels.BODY_OVER else BEYOND
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
def take_exit(state: Any, route: int, bits: int) -> None:
    """Keep which exit the car took at this row, when, and what its verdict will be; do nothing if it took none."""
    for k in range(3):
        if bits >> (kernels.TAKEN_SHIFT + k) & 1:
            direction = k + 1
            state.direction = direction
            state.exit_t = state.t
            delivered = state.heard >> 2 * k & 0b11 if state.past >> k & 1 else state.delivered
            if delivered == direction:
                state.exit = EXIT_COMMANDED
            else:
                state.exit = EXIT_ROUTE if direction == route else EXIT_OTHER
            return


@compiled()
def slow_since(history: Array, row: int, first: int, distance: float) -> int:
    """Return the first row, at or after ``first``, since which the centre moved less than a distance."""
    while history[row].driven - history[first].driven >= distance:
        first += 1
    return first


@compiled()
def measure(numbers: Any, state: Any, history: Array, t: float, metres: float, turn: float, bits: int) -> None:
    """Add the way, the turn and the time from the row before to this one to all lengths, durations and sums."""
    row = state.rows
    seconds = t - state.t if row > 0 else 0.0
    state.driven += metres
    if state.zone == OVER:
        state.area += seconds
        state.turned += abs(turn)
    if 1 <= (bits & kernels.WHEELS) < numbers.wheels_off:
        state.kerb_m += metres
        state.kerb_s += seconds
        if state.kerb_m > numbers.kerb_distance:
            state.flags |= KERB_RIDE
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
        # The car is at rest: count the last second, as far as it is not counted yet and was spent over the area.
        first = row
        while first > state.counted and t - history[first].t < numbers.rest_time:
            first -= 1
        state.rest += history[row].area - history[first].area
        state.counted = row


@compiled()
def decide(state: Any, numbers: Any, history: Array, route: int, watch: float, bits: int) -> int:
    """Return the first verdict in the table's order that holds at this row; 0 if none does.

    ``watch`` is the time for which a drive goes on after an exit, s.
    """
    verdict = harm(numbers, bits)
    if verdict:
        return verdict
    t = state.t
    time_is_out = t >= numbers.time_limit
    zone = state.zone
    if zone == OVER:
        if (
            t - history[state.stand].t >= numbers.stand_time
            or state.rest >= numbers.rest_total
            or state.area >= numbers.area_total
        ):
            return STOPPED_IN_JUNCTION
        if state.turned > numbers.turn_limit:
            return WRONG_WAY
        state.exit = state.direction = 0  # a car that comes back has not left
    elif zone == BEYOND:
        # A wrong way is one without an exit, so an exit that is reached at the same instant comes first.
        if not state.exit:
            take_exit(state, route, bits)
        if state.exit:
            near_next = bits >> (kernels.NEXT_SHIFT + state.direction - 1) & 1
            over = near_next or time_is_out or t - state.exit_t >= watch
            return int(state.exit) if over else 0
        if bits & (kernels.FAR | kernels.IN_OTHER):
            return WRONG_WAY
    waited = t - history[state.wait].t
    if zone <= NEAR and waited >= numbers.wait_time:
        return STOPPED_BEFORE_JUNCTION if zone == NEAR else NOT_ENGAGED
    if not time_is_out:
        return 0
    state.ran_out = 1
    if zone >= OVER:
        return WRONG_WAY if bits & kernels.OPPOSED else UNFINISHED
    if zone == NEAR and waited >= numbers.last_wait_time:
        return STOPPED_BEFORE_JUNCTION
    return NOT_ENGAGED if zone == AHEAD else TIMEOUT


@compiled()
def ends_across(ground: Ground, numbers: Any, state: Any, history: Array, verdict: int) -> bool:
    """Return whether a drive that ends at this row ends in a stop across the car's lane, or outside it.

    The lane is the approach's before the junction, and behind it that of the exit that was taken.
    """
    waited = verdict == STOPPED_BEFORE_JUNCTION or state.t - history[state.wait].t >= numbers.wait_time
    stopped = waited or state.t - history[state.at_rest].t >= numbers.rest_time
    if not stopped or (state.zone >= OVER and not state.exit):
        return False
    head, floats, ints = ground.head[0], ground.floats, ground.ints
    first, segments, width = head.approach, head.approach_count, floats[head.widths + 3]
    if state.zone >= OVER:
        k = state.direction - 1
        first, segments, width = ints[head.exits + 2 * k], ints[head.exits + 2 * k + 1], floats[head.widths + k]
    _, distance, ux, uy = project(floats, first, segments, state.x, state.y)
    along = math.cos(state.yaw) * ux + math.sin(state.yaw) * uy
    return bool(distance > width / 2 or along < numbers.across_cos)


@compiled()
def harm_ahead(ground: Ground, numbers: Any, state: Any, steering: float) -> tuple[int, float, float]:
    """Return the verdict that the next second brings to a car that keeps its speed and this steering, and its place.

    The verdict is 0 if it brings no harm. Other road users do not count: nobody knows where they will be.
    """
    x, y, yaw, v = state.x, state.y, state.yaw, state.v
    curvature = curvature_of(steering, v)
    for _ in range(math.ceil(numbers.ahead_time / AHEAD_STEP)):
        x, y, yaw = moved(x, y, yaw, v, curvature, AHEAD_STEP)
        verdict = harm(numbers, kernels.ground_bits(ground, numbers, x, y, math.cos(yaw), math.sin(yaw)))
        if verdict:
            return verdict, x, y
    return 0, x, y


@compiled()
def close(ground: Ground, numbers: Any, state: Any, history: Array, verdict: int, steering: float, bits: int) -> int:
    """Add what only the last row tells; return the verdict, which for an exit the next second may change."""
    if verdict in (STOPPED_BEFORE_JUNCTION, STOPPED_IN_JUNCTION):
        c, s = math.cos(state.yaw), math.sin(state.yaw)
        state.past_line = nose_past(ground.head[0], numbers, state.x, state.y, c, s)
    if bits & kernels.OPPOSED:
        state.flags |= OPPOSED_LANE
    if ends_across(ground, numbers, state, history, verdict):
        state.flags |= STOPPED_ACROSS
    if verdict == state.exit:
        # A car that steers in pulses looks as if it left the road at each pulse, so straight on must end in harm too.
        ahead, x, y = harm_ahead(ground, numbers, state, steering)
        if ahead and harm_ahead(ground, numbers, state, 0.0)[0]:
            state.x, state.y = x, y
            return ahead
    return verdict


@compiled()
def observe(
    head: Array, floats: Array, ints: Array, cells: Array, numbers: Array, users: Array, row: Array, history: Array,
    route: int, watch: float, t: float, x: float, y: float, yaw: float, v: float, steering: float, command: int,
) -> int:  # fmt: skip
    """Take the next row: place and heading (metres, radians), speed (m/s), steering, and the agent's command.

    The first four are the packed geometry; ``numbers`` is a row of NUMBERS; ``users`` (n, 6) are the other road users;
    ``row`` is a STATE and ``history`` (rows, words) has a MOMENT for each row; both change. ``route`` is the trial's
    direction, 1 to 3; ``watch`` is for how long a drive goes on after an exit, s.

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
    if not math.isfinite(steering):
        return NOT_FINITE
    bits, users_time, solids_time = inspect_row(ground, limits, users, x, y, yaw, v, state.zone >= OVER)
    if bits < 0:
        return NOT_FINITE
    metres = turn = 0.0
    if state.rows > 0:
        dx = x - state.x
        dy = y - state.y
        metres = math.sqrt(dx * dx + dy * dy)
        turn = turn_between(state.yaw, yaw)
    state.zone = zone_after(state.zone, bits)
    measure(limits, state, moments, t, metres, turn, bits)
    keep(state, t, x, y, yaw, v, users_time, solids_time)
    if v > limits.speed_limit:
        state.flags |= SPEEDING
    hear(state, bits, command)
    verdict = decide(state, limits, moments, route, watch, bits)
    if verdict == 0:
        return 0
    state.verdict = close(ground, limits, state, moments, verdict, steering, bits)
    return int(state.verdict)
