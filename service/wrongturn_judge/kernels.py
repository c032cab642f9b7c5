"""The scalar arithmetic of the judge, compiled.

Scored arithmetic is plain float64 with ``math.cos``, ``sin``, ``sqrt`` and ``floor``, without fastmath, so compiled and
interpreted results agree bit for bit. ``packing.py`` fills the arrays.

A polygon is a list of edges ``x1, y1, x2, y2``. A line is a list of segments ``x1, y1, ux, uy, length, s``, where s is
the arc length at the segment's start. A box is ``x, y, cos, sin, half length, half width, radius``.
"""

import math
from typing import Any

import numpy as np
from numba import njit

Array = np.ndarray[Any, Any]

EDGE, SEGMENT, BOX = 4, 6, 7
"""Floats of one polygon edge, line segment, box."""

# Places in the header of the packed integers: first the town's part, then the approach's.
I_CELLS_X, I_CELLS_Y, I_ROAD_ROWS, I_ROAD_LIST, I_ROAD_EDGES = 0, 1, 2, 3, 4
I_BOXES, I_BOX_CELLS_X, I_BOX_CELLS_Y, I_BOX_CELLS, I_BOX_LIST = 5, 6, 7, 8, 9
I_AREAS, I_AREA_TABLE, I_LANES, I_LANE_TABLE = 10, 11, 12, 13
I_APPROACH, I_APPROACH_COUNT, I_EXITS = 14, 15, 16
INTS = 22
"""Length of the header; ``I_EXITS`` takes six."""

# Places in the header of the packed floats.
F_X, F_Y, F_BOX_X, F_BOX_Y, F_STOP_X, F_STOP_Y, F_STOP_UX, F_STOP_UY, F_WIDTHS = 0, 1, 2, 3, 4, 5, 6, 7, 8
FLOATS = 11

CELL = 1.0
"""Side of a cell of the surface grid, m."""
BOX_CELL = 4.0
"""Side of a cell of the boxes' grid, and the stride of the search ahead, m."""

# A surface cell is one byte: road in bits 0-1, junction areas in bits 2-3, lanes in bits 4-7.
ROAD_IN, ROAD_EDGE = 1, 2
AREA_OWN, AREA_OTHER, AREA_EDGE = 1, 2, 3
LANE_EDGE = 15

# Numbers of a judge: thresholds and body.
N_ENGAGE, N_WRONG_WAY, N_EXIT, N_EXIT_COS, N_COMMAND, N_TTC = 0, 1, 2, 3, 4, 5
N_FRONT_AXLE, N_REAR_AXLE, N_WHEEL_SIDE, N_HALF_LENGTH, N_HALF_WIDTH, N_RADIUS = 6, 7, 8, 9, 10, 11
N_TIME_LIMIT, N_WHEELS_OFF = 12, 13
N_STAND_DISTANCE, N_STAND_TIME, N_REST_DISTANCE, N_REST_TIME, N_REST_TOTAL, N_AREA_TOTAL = 14, 15, 16, 17, 18, 19
N_WAIT_DISTANCE, N_WAIT_TIME, N_LAST_WAIT_TIME, N_OPPOSED_DISTANCE = 20, 21, 22, 23
NUMBERS = 24

# What the kernel found at a row, as bits of one integer.
WHEELS = 0b111
CENTRE_OFF, IN_AREA, IN_OTHER, HIT, OPPOSED = 1 << 3, 1 << 4, 1 << 5, 1 << 6, 1 << 7
"""``OPPOSED``: the centre is in a lane whose direction is opposed to the heading."""
FAR, ENGAGED = 1 << 8, 1 << 9
PAST_SHIFT, TAKEN_SHIFT = 11, 14
"""Three bits each, in the order of DIRECTIONS: the car is past the exit line by the command's distance; it took the
exit."""
NOT_FINITE = -1
OVERLAP = -1.0
"""Time to contact of boxes that overlap already."""


@njit(cache=True)
def inside(floats: Array, first: int, edges: int, x: float, y: float) -> bool:
    """Return whether a point lies in a polygon (even-odd rule, half-open at the boundary)."""
    odd = False
    for i in range(first, first + EDGE * edges, EDGE):
        y1 = floats[i + 1]
        y2 = floats[i + 3]
        if (y1 > y) != (y2 > y):
            x1 = floats[i]
            if x < x1 + (floats[i + 2] - x1) * (y - y1) / (y2 - y1):
                odd = not odd
    return odd


@njit(cache=True)
def covers(floats: Array, first: int, edges: int, x: float, y: float) -> bool:
    """Return what :func:`inside` does for a polygon with bounds before its edges, which usually decide at once."""
    if x < floats[first - 4] or y < floats[first - 3] or x > floats[first - 2] or y > floats[first - 1]:
        return False
    return inside(floats, first, edges, x, y)


@njit(cache=True)
def inside_listed(floats: Array, first: int, ints: Array, begin: int, end: int, x: float, y: float) -> bool:
    """Return what :func:`inside` does; ``ints[begin:end]`` lists the edges that meet the point's row of cells."""
    odd = False
    for k in range(begin, end):
        i = first + EDGE * ints[k]
        y1 = floats[i + 1]
        y2 = floats[i + 3]
        if (y1 > y) != (y2 > y):
            x1 = floats[i]
            if x < x1 + (floats[i + 2] - x1) * (y - y1) / (y2 - y1):
                odd = not odd
    return odd


@njit(cache=True)
def distance_to_edges(floats: Array, first: int, edges: int, x: float, y: float) -> float:
    """Return the distance of a point from the nearest edge, m."""
    best = math.inf
    for i in range(first, first + EDGE * edges, EDGE):
        ax = floats[i]
        ay = floats[i + 1]
        bx = floats[i + 2] - ax
        by = floats[i + 3] - ay
        square = bx * bx + by * by
        along = 0.0
        if square > 0.0:
            along = ((x - ax) * bx + (y - ay) * by) / square
            along = min(max(along, 0.0), 1.0)
        dx = x - (ax + bx * along)
        dy = y - (ay + by * along)
        best = min(best, dx * dx + dy * dy)
    return math.sqrt(best)


@njit(cache=True)
def project(floats: Array, first: int, segments: int, x: float, y: float) -> tuple[float, float, float, float]:
    """Return the arc length and distance of a line's nearest point, and the line's unit vector there."""
    best = math.inf
    s = ux = uy = 0.0
    for i in range(first, first + SEGMENT * segments, SEGMENT):
        px = x - floats[i]
        py = y - floats[i + 1]
        along = min(max(px * floats[i + 2] + py * floats[i + 3], 0.0), floats[i + 4])
        dx = px - floats[i + 2] * along
        dy = py - floats[i + 3] * along
        square = dx * dx + dy * dy
        if square < best:
            best = square
            s = floats[i + 5] + along
            ux = floats[i + 2]
            uy = floats[i + 3]
    return s, math.sqrt(best), ux, uy


@njit(cache=True)
def contact(
    dx: float, dy: float, wx: float, wy: float, c1: float, s1: float, length1: float, width1: float,
    c2: float, s2: float, length2: float, width2: float,
) -> float:  # fmt: skip
    """Return the time until two oriented boxes overlap, s: -1 if they overlap now, inf if they never will.

    ``dx, dy`` leads from the first centre to the second, ``wx, wy`` is the second's velocity relative to the first's.
    Lengths and widths are halves. The result is exact: a separating-axis test with the time as a parameter. Boxes that
    only touch do not overlap.
    """
    enter = -math.inf
    leave = math.inf
    cosine = abs(c1 * c2 + s1 * s2)
    sine = abs(c1 * s2 - s1 * c2)
    for axis in range(4):
        if axis == 0:
            nx, ny, reach = c1, s1, length1 + length2 * cosine + width2 * sine
        elif axis == 1:
            nx, ny, reach = -s1, c1, width1 + length2 * sine + width2 * cosine
        elif axis == 2:
            nx, ny, reach = c2, s2, length2 + length1 * cosine + width1 * sine
        else:
            nx, ny, reach = -s2, c2, width2 + length1 * sine + width1 * cosine
        gap = dx * nx + dy * ny
        speed = wx * nx + wy * ny
        if speed == 0.0:
            if abs(gap) >= reach:
                return math.inf
        else:
            first = (-reach - gap) / speed
            last = (reach - gap) / speed
            enter = max(enter, min(first, last))
            leave = min(leave, max(first, last))
    if enter >= leave or leave <= 0.0:
        return math.inf
    return enter if enter >= 0.0 else OVERLAP


@njit(cache=True)
def box_meets(
    floats: Array, first: int, edges: int, x: float, y: float, c: float, s: float, half_length: float, half_width: float
) -> bool:
    """Return whether an oriented box overlaps a polygon. If they only touch, they do not overlap."""
    if inside(floats, first, edges, x, y):
        return True
    for i in range(first, first + EDGE * edges, EDGE):
        # Clip the edge, in the box's frame, with the two strips that make up the box.
        ax = floats[i] - x
        ay = floats[i + 1] - y
        bx = floats[i + 2] - floats[i]
        by = floats[i + 3] - floats[i + 1]
        enter = 0.0
        leave = 1.0
        for axis in range(2):
            if axis == 0:
                at, along, half = ax * c + ay * s, bx * c + by * s, half_length
            else:
                at, along, half = ay * c - ax * s, by * c - bx * s, half_width
            if along == 0.0:
                if abs(at) >= half:
                    leave = -1.0
            else:
                one = (-half - at) / along
                two = (half - at) / along
                enter = max(enter, min(one, two))
                leave = min(leave, max(one, two))
        if enter < leave:
            return True
    return False


@njit(cache=True)
def nose_past(floats: Array, numbers: Array, x: float, y: float, c: float, s: float) -> float:
    """Return how far the middle of the front bumper is past the stop line, extended straight, m."""
    nose = numbers[N_HALF_LENGTH]
    over = (x + c * nose - floats[F_STOP_X]) * floats[F_STOP_UX]
    over += (y + s * nose - floats[F_STOP_Y]) * floats[F_STOP_UY]
    return float(over)


@njit(cache=True)
def surface(floats: Array, ints: Array, cells: Array, x: float, y: float) -> tuple[bool, int, int]:
    """Return what lies under a point: whether road; 0, AREA_OWN or AREA_OTHER; the lane's number from 1, or 0."""
    column = math.floor((x - floats[F_X]) / CELL)
    row = math.floor((y - floats[F_Y]) / CELL)
    if not (0 <= column < ints[I_CELLS_X] and 0 <= row < ints[I_CELLS_Y]):
        return False, 0, 0
    code: Any = np.int64(cells[row * ints[I_CELLS_X] + column])
    road = (code & 3) == ROAD_IN
    if (code & 3) == ROAD_EDGE:
        rows = ints[I_ROAD_ROWS] + row
        begin = ints[I_ROAD_LIST]
        road = inside_listed(floats, ints[I_ROAD_EDGES], ints, begin + ints[rows], begin + ints[rows + 1], x, y)
    area = (code >> 2) & 3
    lane = code >> 4
    if area == AREA_EDGE or lane == LANE_EDGE:
        area = 0
        for k in range(ints[I_AREAS]):
            table = ints[I_AREA_TABLE] + 2 * k
            if covers(floats, ints[table], ints[table + 1], x, y):
                area = AREA_OWN if k == 0 else AREA_OTHER
                break
    if lane == LANE_EDGE:
        lane = 0
        for k in range(ints[I_LANES]):
            table = ints[I_LANE_TABLE] + 4 * k
            if covers(floats, ints[table], ints[table + 1], x, y):
                lane = k + 1
                break
    return road, area, lane if area == 0 else 0


@njit(cache=True)
def on_road(floats: Array, ints: Array, cells: Array, x: float, y: float) -> bool:
    """Return whether a point lies on the road."""
    column = math.floor((x - floats[F_X]) / CELL)
    row = math.floor((y - floats[F_Y]) / CELL)
    if not (0 <= column < ints[I_CELLS_X] and 0 <= row < ints[I_CELLS_Y]):
        return False
    code: Any = np.int64(cells[row * ints[I_CELLS_X] + column]) & 3
    if code == ROAD_EDGE:
        rows = ints[I_ROAD_ROWS] + row
        first = ints[I_ROAD_LIST]
        return inside_listed(floats, ints[I_ROAD_EDGES], ints, first + ints[rows], first + ints[rows + 1], x, y)
    return bool(code == ROAD_IN)


@njit(cache=True)
def wheels_off(floats: Array, ints: Array, cells: Array, numbers: Array, x: float, y: float, c: float, s: float) -> int:
    """Return how many of the four wheels are off the road."""
    off = 0
    for wheel in range(4):
        forward = numbers[N_FRONT_AXLE] if wheel < 2 else numbers[N_REAR_AXLE]
        left = numbers[N_WHEEL_SIDE] if wheel % 2 == 0 else -numbers[N_WHEEL_SIDE]
        if not on_road(floats, ints, cells, x + c * forward - s * left, y + s * forward + c * left):
            off += 1
    return off


@njit(cache=True)
def least_contact(
    floats: Array, ints: Array, numbers: Array, users: Array, x: float, y: float, c: float, s: float, v: float
) -> float:
    """Return the time until the body meets a solid box or a road user, if all go straight on at their speed, s.

    It is -1 if the body overlaps one now, and inf beyond the horizon.
    """
    half_length = numbers[N_HALF_LENGTH]
    half_width = numbers[N_HALF_WIDTH]
    best = math.inf
    for k in range(users.shape[0]):
        c2 = math.cos(users[k, 2])
        s2 = math.sin(users[k, 2])
        time = contact(
            users[k, 0] - x, users[k, 1] - y, users[k, 5] * c2 - v * c, users[k, 5] * s2 - v * s,
            c, s, half_length, half_width, c2, s2, users[k, 3] / 2, users[k, 4] / 2,
        )  # fmt: skip
        best = min(best, time)
    # Each box is listed in every cell from which the body may touch it within half a stride. So a search in full
    # strides along the heading meets every box in the way, the nearest first.
    columns = ints[I_BOX_CELLS_X]
    strides = math.ceil(v * numbers[N_TTC] / BOX_CELL)
    for stride in range(strides + 1):
        if (stride - 0.5) * BOX_CELL > best * v:
            break
        column = math.floor((x + c * BOX_CELL * stride - floats[F_BOX_X]) / BOX_CELL)
        row = math.floor((y + s * BOX_CELL * stride - floats[F_BOX_Y]) / BOX_CELL)
        if not (0 <= column < columns and 0 <= row < ints[I_BOX_CELLS_Y]):
            continue
        cell = ints[I_BOX_CELLS] + row * columns + column
        for k in range(ints[cell], ints[cell + 1]):
            box = ints[I_BOXES] + BOX * ints[ints[I_BOX_LIST] + k]
            dx = floats[box] - x
            dy = floats[box + 1] - y
            # A circle around the box shows fast that it is beside the corridor or behind the car.
            radius = floats[box + 6] + numbers[N_RADIUS]
            if abs(dy * c - dx * s) > radius or dx * c + dy * s < -radius:
                continue
            time = contact(
                dx, dy, -v * c, -v * s, c, s, half_length, half_width,
                floats[box + 2], floats[box + 3], floats[box + 4], floats[box + 5],
            )  # fmt: skip
            best = min(best, time)
    return best if best <= numbers[N_TTC] else math.inf


@njit(cache=True)
def inspect_row(
    floats: Array, ints: Array, cells: Array, numbers: Array, users: Array,
    x: float, y: float, yaw: float, v: float, entered: bool,
) -> tuple[int, float]:  # fmt: skip
    """Return what the judge needs of one row: the packed bits, and the time to contact (inf if there is none).

    ``entered`` says whether the centre has been in the junction's area. Exits and wrong ways are only looked for then.
    """
    if not math.isfinite(x + y + yaw + v):
        return NOT_FINITE, math.inf
    c = math.cos(yaw)
    s = math.sin(yaw)
    road, area, lane = surface(floats, ints, cells, x, y)
    bits = 0 if road else CENTRE_OFF
    if area == AREA_OWN:
        bits |= IN_AREA
    elif area == AREA_OTHER:
        bits |= IN_OTHER

    if lane != 0:
        table = ints[I_LANE_TABLE] + 4 * (lane - 1)
        _, _, ux, uy = project(floats, ints[table + 2], ints[table + 3], x, y)
        if c * ux + s * uy < 0.0:
            bits |= OPPOSED
    bits += wheels_off(floats, ints, cells, numbers, x, y, c, s)

    time = least_contact(floats, ints, numbers, users, x, y, c, s, v)
    if time < 0.0:
        bits |= HIT
        time = 0.0

    if not entered:
        remaining, distance, _, _ = project(floats, ints[I_APPROACH], ints[I_APPROACH_COUNT], x, y)
        last = ints[I_APPROACH] + SEGMENT * (ints[I_APPROACH_COUNT] - 1)
        remaining = floats[last + 5] + floats[last + 4] - remaining
        if remaining <= numbers[N_ENGAGE] and distance <= numbers[N_ENGAGE]:
            bits |= ENGAGED
    elif area != AREA_OWN:
        table = ints[I_AREA_TABLE]
        if distance_to_edges(floats, ints[table], ints[table + 1], x, y) > numbers[N_WRONG_WAY]:
            bits |= FAR
        rear = numbers[N_HALF_LENGTH]
        for k in range(3):
            first = ints[I_EXITS + 2 * k]
            segments = ints[I_EXITS + 2 * k + 1]
            if segments == 0:
                continue
            past, distance, ux, uy = project(floats, first, segments, x, y)
            if past > numbers[N_COMMAND]:
                bits |= 1 << (PAST_SHIFT + k)
            if distance <= floats[F_WIDTHS + k] / 2 and c * ux + s * uy >= numbers[N_EXIT_COS]:
                past, _, _, _ = project(floats, first, segments, x - c * rear, y - s * rear)
                if past >= numbers[N_EXIT]:
                    bits |= 1 << (TAKEN_SHIFT + k)
    return bits, time
