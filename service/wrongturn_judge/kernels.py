"""The scalar arithmetic of the judge, compiled.

Scored arithmetic is plain float64 with ``math.cos``, ``sin``, ``sqrt`` and ``floor``, without fastmath, so compiled and
interpreted results agree bit for bit. ``packing.py`` fills the arrays.

A polygon is a list of edges ``x1, y1, x2, y2``. A line is a list of segments ``x1, y1, ux, uy, length, s``, where s is
the arc length at the segment's start. A box is ``x, y, cos, sin, half length, half width, radius``.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from wrongturn_judge.compiling import compiled, record

Array = np.ndarray[Any, Any]

EDGE, SEGMENT, BOX = 4, 6, 7
"""Floats of one polygon edge, line segment, box."""

HEAD = record(
    "x y box_x box_y stop_x stop_y stop_ux stop_uy",
    "cells_x cells_y road_rows road_list road_edges boxes box_cells_x box_cells_y box_cells box_list "
    "areas area_table lanes lane_table approach approach_count exits widths candidates candidates_width onward",
)
"""The head of a packed geometry: corners of the grids, the stop line and the unit vector across it; sizes of the grids,
counts, and where each list begins in the floats or ints. First comes the town's part, then the approach's, whose width
is the last of the widths; the last three are a journey's, which has no approach."""

CELL = 1.0
"""Side of a cell of the surface grid, m."""
BOX_CELL = 4.0
"""Side of a cell of the boxes' grid, and the stride of the search ahead, m."""

# A surface cell is one byte: road in bits 0-1, junction areas in bits 2-3, lanes in bits 4-7.
ROAD_IN, ROAD_EDGE = 1, 2
AREA_OWN, AREA_OTHER, AREA_EDGE = 1, 2, 3
LANE_EDGE = 15

NUMBERS = record(
    "engage_distance wrong_way_distance exit_distance exit_cos watch_distance ahead_time command_distance ttc_horizon "
    "time_limit wheels_off stand_distance stand_time rest_distance rest_time rest_total area_total turn_limit "
    "wait_distance wait_time last_wait_time opposed_distance across_cos speed_limit kerb_distance "
    "journey_stop_speed journey_wrong_way_time journey_stand_time journey_back_time "
    "front_axle rear_axle wheel_side half_length half_width radius"
)
"""Numbers of a judge: thresholds, by their names, and the body."""

# What the kernel found at a row, as bits of one integer.
WHEELS = 0b111
CENTRE_OFF, IN_AREA, IN_OTHER, HIT, OPPOSED = 1 << 3, 1 << 4, 1 << 5, 1 << 6, 1 << 7
"""``OPPOSED``: the centre is in a lane whose direction is opposed to the heading."""
FAR, ENGAGED, BODY_OVER = 1 << 8, 1 << 9, 1 << 10
"""``BODY_OVER``: the body is over the junction's area, and the centre is not."""
PAST_SHIFT, TAKEN_SHIFT, NEXT_SHIFT = 11, 14, 17
"""Three bits each, in the order of DIRECTIONS: the car is past the exit line by the command's distance; it took the
exit; it is near the next stop line along the exit's lane."""
NOT_FINITE = -1
OVERLAP = -1.0
"""Time to contact of boxes that overlap already."""


class Ground(NamedTuple):
    """A packed geometry."""

    head: Array
    """(1,) of HEAD"""
    floats: Array
    ints: Array
    cells: Array
    """A byte for each cell of the surface grid."""


@compiled()
def crosses(floats: Array, i: int, x: float, y: float) -> bool:
    """Return whether the ray from a point to the right crosses the edge at ``i``, half-open at its ends."""
    y1, y2 = floats[i + 1], floats[i + 3]
    if (y1 > y) == (y2 > y):
        return False
    x1 = floats[i]
    return bool(x < x1 + (floats[i + 2] - x1) * (y - y1) / (y2 - y1))


@compiled()
def inside(floats: Array, first: int, edges: int, x: float, y: float) -> bool:
    """Return whether a point lies in a polygon (even-odd rule)."""
    odd = False
    for i in range(first, first + EDGE * edges, EDGE):
        if crosses(floats, i, x, y):
            odd = not odd
    return odd


@compiled()
def covers(floats: Array, first: int, edges: int, x: float, y: float) -> bool:
    """Return what :func:`inside` does for a polygon with bounds before its edges, which usually decide at once."""
    if x < floats[first - 4] or y < floats[first - 3] or x > floats[first - 2] or y > floats[first - 1]:
        return False
    return inside(floats, first, edges, x, y)


@compiled()
def inside_listed(floats: Array, first: int, ints: Array, begin: int, end: int, x: float, y: float) -> bool:
    """Return what :func:`inside` does; ``ints[begin:end]`` lists the edges that meet the point's row of cells."""
    odd = False
    for k in range(begin, end):
        if crosses(floats, first + EDGE * ints[k], x, y):
            odd = not odd
    return odd


@compiled()
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


@compiled()
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


@compiled()
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


@compiled()
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


@compiled()
def nose_past(head: Any, numbers: Any, x: float, y: float, c: float, s: float) -> float:
    """Return how far the middle of the front bumper is past the stop line, extended straight, m."""
    nose = numbers.half_length
    over = (x + c * nose - head.stop_x) * head.stop_ux
    over += (y + s * nose - head.stop_y) * head.stop_uy
    return float(over)


@compiled()
def cell_at(head: Any, x: float, y: float) -> int:
    """Return the number of the surface cell that a point lies in; -1 outside the grid."""
    column = math.floor((x - head.x) / CELL)
    row = math.floor((y - head.y) / CELL)
    if not (0 <= column < head.cells_x and 0 <= row < head.cells_y):
        return -1
    return int(row * head.cells_x + column)


@compiled()
def road_in(ground: Ground, cell: int, x: float, y: float) -> bool:
    """Return whether a point of a cell lies on the road."""
    head, ints = ground.head[0], ground.ints
    code: Any = np.int64(ground.cells[cell]) & 3
    if code == ROAD_EDGE:
        rows = head.road_rows + cell // head.cells_x
        first = head.road_list
        return inside_listed(ground.floats, head.road_edges, ints, first + ints[rows], first + ints[rows + 1], x, y)
    return bool(code == ROAD_IN)


@compiled()
def surface(ground: Ground, x: float, y: float) -> tuple[bool, int, int]:
    """Return what lies under a point: whether road; 0, AREA_OWN or AREA_OTHER; the lane's number from 1, or 0."""
    head, floats, ints = ground.head[0], ground.floats, ground.ints
    cell = cell_at(head, x, y)
    if cell < 0:
        return False, 0, 0
    code: Any = np.int64(ground.cells[cell])
    area = (code >> 2) & 3
    lane = code >> 4
    if area == AREA_EDGE or lane == LANE_EDGE:
        area = 0
        for k in range(head.areas):
            table = head.area_table + 2 * k
            if covers(floats, ints[table], ints[table + 1], x, y):
                area = AREA_OWN if k == 0 else AREA_OTHER
                break
    if lane == LANE_EDGE:
        lane = 0
        for k in range(head.lanes):
            table = head.lane_table + 4 * k
            if covers(floats, ints[table], ints[table + 1], x, y):
                lane = k + 1
                break
    return road_in(ground, cell, x, y), area, lane if area == 0 else 0


@compiled()
def wheels_off(ground: Ground, numbers: Any, x: float, y: float, c: float, s: float) -> int:
    """Return how many of the four wheels are off the road."""
    off = 0
    for wheel in range(4):
        forward = numbers.front_axle if wheel < 2 else numbers.rear_axle
        left = numbers.wheel_side if wheel % 2 == 0 else -numbers.wheel_side
        wheel_x, wheel_y = x + c * forward - s * left, y + s * forward + c * left
        cell = cell_at(ground.head[0], wheel_x, wheel_y)
        if cell < 0 or not road_in(ground, cell, wheel_x, wheel_y):
            off += 1
    return off


@compiled()
def contact_with_users(numbers: Any, users: Array, x: float, y: float, c: float, s: float, v: float) -> float:
    """Return the time until the body meets a road user, if all go straight on at their speed, s.

    It is -1 if the body overlaps one now, and inf beyond the horizon.
    """
    best = math.inf
    for k in range(users.shape[0]):
        c2 = math.cos(users[k, 2])
        s2 = math.sin(users[k, 2])
        time = contact(
            users[k, 0] - x, users[k, 1] - y, users[k, 5] * c2 - v * c, users[k, 5] * s2 - v * s,
            c, s, numbers.half_length, numbers.half_width, c2, s2, users[k, 3] / 2, users[k, 4] / 2,
        )  # fmt: skip
        best = min(best, time)
    return best if best <= numbers.ttc_horizon else math.inf


@compiled()
def contact_with_solids(ground: Ground, numbers: Any, x: float, y: float, c: float, s: float, v: float) -> float:
    """Return the same for the town's solid boxes."""
    head, floats, ints = ground.head[0], ground.floats, ground.ints
    half_length = numbers.half_length
    half_width = numbers.half_width
    best = math.inf
    # Each box is listed in every cell from which the body may touch it within half a stride. So a search in full
    # strides along the heading meets every box in the way, the nearest first.
    columns = head.box_cells_x
    strides = math.ceil(v * numbers.ttc_horizon / BOX_CELL)
    for stride in range(strides + 1):
        if (stride - 0.5) * BOX_CELL > best * v:
            break
        column = math.floor((x + c * BOX_CELL * stride - head.box_x) / BOX_CELL)
        row = math.floor((y + s * BOX_CELL * stride - head.box_y) / BOX_CELL)
        if not (0 <= column < columns and 0 <= row < head.box_cells_y):
            continue
        cell = head.box_cells + row * columns + column
        for k in range(ints[cell], ints[cell + 1]):
            box = head.boxes + BOX * ints[head.box_list + k]
            dx = floats[box] - x
            dy = floats[box + 1] - y
            # A circle around the box shows fast that it is beside the corridor or behind the car.
            radius = floats[box + 6] + numbers.radius
            if abs(dy * c - dx * s) > radius or dx * c + dy * s < -radius:
                continue
            time = contact(
                dx, dy, -v * c, -v * s, c, s, half_length, half_width,
                floats[box + 2], floats[box + 3], floats[box + 4], floats[box + 5],
            )  # fmt: skip
            best = min(best, time)
    return best if best <= numbers.ttc_horizon else math.inf


@compiled()
def ground_bits(ground: Ground, numbers: Any, x: float, y: float, c: float, s: float) -> int:
    """Return CENTRE_OFF, the wheels off the road and HIT, as far as the town without its road users tells them."""
    cell = cell_at(ground.head[0], x, y)
    bits = 0 if cell >= 0 and road_in(ground, cell, x, y) else CENTRE_OFF
    bits += wheels_off(ground, numbers, x, y, c, s)
    if contact_with_solids(ground, numbers, x, y, c, s, 0.0) < 0.0:
        bits |= HIT
    return bits


@compiled()
def inspect_row(
    ground: Ground, numbers: Any, users: Array, x: float, y: float, yaw: float, v: float, entered: bool
) -> tuple[int, float, float]:
    """Return what the judge needs of one row: the packed bits, and the times to contact with users and solids.

    ``entered`` says whether the centre has been in the junction's area. Exits and wrong ways are only looked for then.
    """
    if not math.isfinite(x + y + yaw + v):
        return NOT_FINITE, math.inf, math.inf
    head, floats, ints = ground.head[0], ground.floats, ground.ints
    c = math.cos(yaw)
    s = math.sin(yaw)
    road, area, lane = surface(ground, x, y)
    bits = 0 if road else CENTRE_OFF
    if area == AREA_OWN:
        bits |= IN_AREA
    elif area == AREA_OTHER:
        bits |= IN_OTHER

    if lane != 0:
        table = head.lane_table + 4 * (lane - 1)
        _, _, ux, uy = project(floats, ints[table + 2], ints[table + 3], x, y)
        if c * ux + s * uy < 0.0:
            bits |= OPPOSED
    bits += wheels_off(ground, numbers, x, y, c, s)

    users_time = contact_with_users(numbers, users, x, y, c, s, v)
    solids_time = contact_with_solids(ground, numbers, x, y, c, s, v)
    if users_time < 0.0 or solids_time < 0.0:
        bits |= HIT

    if not entered:
        remaining, distance, _, _ = project(floats, head.approach, head.approach_count, x, y)
        last = head.approach + SEGMENT * (head.approach_count - 1)
        remaining = floats[last + 5] + floats[last + 4] - remaining
        if remaining <= numbers.engage_distance and distance <= numbers.engage_distance:
            bits |= ENGAGED
    elif area != AREA_OWN:
        first, edges = ints[head.area_table], ints[head.area_table + 1]
        distance = distance_to_edges(floats, first, edges, x, y)
        if distance > numbers.wrong_way_distance:
            bits |= FAR
        rear = numbers.half_length
        if distance < numbers.radius and box_meets(floats, first, edges, x, y, c, s, rear, numbers.half_width):
            bits |= BODY_OVER
        for k in range(3):
            first, segments = ints[head.exits + 2 * k], ints[head.exits + 2 * k + 1]
            if segments == 0:
                continue
            past, distance, ux, uy = project(floats, first, segments, x, y)
            if past > numbers.command_distance:
                bits |= 1 << (PAST_SHIFT + k)
            last = first + SEGMENT * (segments - 1)
            if floats[last + 5] + floats[last + 4] - past < numbers.watch_distance:
                bits |= 1 << (NEXT_SHIFT + k)
            if distance <= floats[head.widths + k] / 2 and c * ux + s * uy >= numbers.exit_cos:
                past, _, _, _ = project(floats, first, segments, x - c * rear, y - s * rear)
                if past >= numbers.exit_distance:
                    bits |= 1 << (TAKEN_SHIFT + k)
    return bits, max(users_time, 0.0), max(solids_time, 0.0)
