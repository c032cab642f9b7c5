"""The other road users of a fleet's egos: where they are, and which of them an ego can see.

Each ego has road users of its own, in its row of every array. They mind their ego and each other and no other ego.
"""

import math
from typing import NamedTuple

import numpy as np

from wrongturn_judge.compiling import uncounted
from wrongturn_judge.kernels import Array
from wrongturn_sim import guide
from wrongturn_sim.fleet.streets import Streets
from wrongturn_sim.traffic import crowd

VEHICLES, PEDESTRIANS = 0, 1
"""Columns of ``Others.counts``: the number of each kind."""
HESITANT, LEADS, MEETS, WAITS = 0, 1, 2, 3
"""Columns of ``Others.habits``: share of the cars that drive hesitantly, of the drives with a car shortly ahead, of the
junctions at which the ego meets a car, and of those at which a car stands.
"""

# Floats of a car: metres of its front bumper along its line; speed, m/s; acceleration until the next decision; body;
# number of its colour; share of the speed limit that its driver likes; seconds that it has waited at its stop line;
# seconds until it stops without need (below 0: it stops), and how long it then stands (0: its driver never does);
# seconds that it still stays at its stop line without need; place of its body's centre, and metres driven since the car
# was there (0, unless the ego is far away).
S, V, A, LENGTH, WIDTH, HEIGHT, COLOUR, LIKES, WAITED, UNTIL, STANDS, STAYS, X, Y, YAW, SINCE = range(16)
CAR_FLOATS = 16
# Ints of a car: its leg; the exit that it takes at the leg's end (-1: none); whether its line is that exit's path,
# which leads through the junction and along the exit's lane; whether the junction is kept free for it; whether it is in
# town: where a lane ends at the edge of the town, a car leaves and comes back at an entry; the leg of the ego for whose
# sake it stays at its stop line, until the ego has left that leg (-1: none).
LEG, GATE, INSIDE, GOES, HERE, FOR = range(6)
CAR_INTS = 6

# Floats of a walker: metres along the pavement; speed, m/s, below 0 against the pavement's direction; metres to the
# left of its line; height; number of the colour; place, and metres walked since, as for cars.
W_S, W_V, W_ASIDE, W_HEIGHT, W_COLOUR, W_X, W_Y, W_YAW, W_SINCE = range(9)
WALKER_FLOATS = 9

RANGE = crowd.VISIBLE_RANGE
SLACK, OFTEN = 3.0, 20.0
"""Who is this much farther away than the ego sees is only placed anew after so many metres."""
PEDESTRIAN_SIZE = crowd.PEDESTRIAN_SIZE
USER, PICTURE = 6, crowd.OTHERS
"""Numbers of a road user for the judge (x, y, yaw, length, width, speed) and for pictures."""

SAMPLES = 31
"""Number of points of the ego's way that are checked for others."""


class Others(NamedTuple):
    """Road users of each ego."""

    counts: Array
    """(n, 2) int64: how many cars and pedestrians each ego has."""
    habits: Array
    """(n, 4)"""
    junction: Array
    """(n, 2) int64: leg at whose end it was last drawn whether the ego meets a car, and one that stands; -1 before."""
    random: Array
    """(n,) int64: state of each ego's random numbers."""
    cars: Array
    """(n, most cars, CAR_FLOATS)"""
    ways: Array
    """(n, most cars, CAR_INTS) int64"""
    walkers: Array
    """(n, most pedestrians, WALKER_FLOATS)"""
    walks: Array
    """(n, most pedestrians) int64: pavement of each."""
    users: Array
    """(n, most, USER): those that the ego can see, nearest first, for the judge."""
    pictures: Array
    """(n, most, PICTURE): the same for pictures."""
    seen: Array
    """(n,) int64: how many they are."""
    near: Array
    """(n, most): squares of their distances."""
    way: Array
    """(n, SAMPLES, 4): points of the ego's way ahead and the way's unit vectors there."""
    permitted: Array
    """(n,): the greatest speed that traffic permits the ego, m/s; inf where nobody is in its way."""


def others_for(count: int, vehicles: int, pedestrians: int) -> Others:
    """Return empty arrays for ``count`` egos with at most this many road users each."""
    most = vehicles + pedestrians
    return Others(
        counts=np.zeros((count, 2), np.int64),
        habits=np.zeros((count, 4)),
        junction=np.full((count, 2), -1, np.int64),
        random=np.zeros(count, np.int64),
        cars=np.zeros((count, vehicles, CAR_FLOATS)),
        ways=np.zeros((count, vehicles, CAR_INTS), np.int64),
        walkers=np.zeros((count, pedestrians, WALKER_FLOATS)),
        walks=np.zeros((count, pedestrians), np.int64),
        users=np.zeros((count, most, USER)),
        pictures=np.zeros((count, most, PICTURE)),
        seen=np.zeros(count, np.int64),
        near=np.zeros((count, most)),
        way=np.zeros((count, SAMPLES, 4)),
        permitted=np.full(count, np.inf),
    )


@uncounted
def draw(others: Others, i: int) -> float:
    """Return the next random number of an ego's traffic, from 0 to below 1."""
    state = others.random[i] * 6364136223846793005 + 1442695040888963407
    others.random[i] = state
    return float((state >> 33) & 0x7FFFFFFF) / 2147483648.0


@uncounted
def point_on(points: Array, along: Array, first: int, end: int, s: float) -> tuple[float, float, float, float]:
    """Return the point of a line at a distance along it, and the line's unit vector there."""
    low, high = first, end - 2
    while low < high:
        middle = (low + high + 1) // 2
        if along[middle] <= s:
            low = middle
        else:
            high = middle - 1
    dx, dy = points[low + 1, 0] - points[low, 0], points[low + 1, 1] - points[low, 1]
    length = math.sqrt(dx * dx + dy * dy)
    ux, uy = (dx / length, dy / length) if length > 0.0 else (1.0, 0.0)
    ahead = s - along[low]
    return points[low, 0] + ahead * ux, points[low, 1] + ahead * uy, ux, uy


@uncounted
def point_ahead(
    points: Array, along: Array, legs: Array, lengths: Array, leg: int, gate: int, inside: int, s: float
) -> tuple[float, float, float, float]:
    """Return the point ``s`` metres along a way, and the way's unit vector there.

    Distances count from the start of a leg's lane or, ``inside`` the junction, of its exit's path. Before the path lies
    the leg's lane, after the lane its exit's path.
    """
    length = lengths[leg, guide.F_LENGTH]
    at = guide.L_GATE + guide.GATE_INTS * gate
    if inside:
        if s >= 0.0:
            return point_on(points, along, legs[leg, at + guide.G_FIRST], legs[leg, at + guide.G_END], s)
        s += length
    elif s > length and gate >= 0:
        return point_on(points, along, legs[leg, at + guide.G_FIRST], legs[leg, at + guide.G_END], s - length)
    return point_on(points, along, legs[leg, guide.L_FIRST], legs[leg, guide.L_END], s)


@uncounted
def rounded(value: float, per_unit: float) -> float:
    """Return a value rounded as SUMO's road users are, so that both look the same."""
    return math.floor(value * per_unit + 0.5) / per_unit


@uncounted
def place_car(points: Array, along: Array, legs: Array, lengths: Array, car: Array, way: Array) -> None:
    """Set the place of a car's body: both bumpers are on its line."""
    leg, gate, inside = way[LEG], way[GATE], way[INSIDE]
    fx, fy, _, _ = point_ahead(points, along, legs, lengths, leg, gate, inside, car[S])
    bx, by, _, _ = point_ahead(points, along, legs, lengths, leg, gate, inside, car[S] - car[LENGTH])
    yaw = float(int(math.atan2(fy - by, fx - bx) * 1e4)) / 1e4
    half = 0.5 * car[LENGTH]
    car[SINCE] = 0.0
    car[X], car[Y], car[YAW] = rounded(fx - half * math.cos(yaw), 1e3), rounded(fy - half * math.sin(yaw), 1e3), yaw


@uncounted
def out_of_sight(x: float, y: float, since: float, state: Array) -> bool:
    """Return whether nobody needs to know where a road user is that was at a point ``since`` metres ago."""
    reach = RANGE + since + SLACK
    dx, dy = x - state[0], y - state[1]
    return bool(since < OFTEN and dx * dx + dy * dy > reach * reach)


@uncounted
def move_walker(streets: Streets, walker: Array, walk: int, seconds: float) -> None:
    """Let a pedestrian walk on; at the end of a pavement that is no ring they turn round."""
    end = streets.walks[walk, 1]
    length = streets.along[end - 1]
    s = walker[W_S] + walker[W_V] * seconds
    if streets.walks[walk, 2] != 0:
        s = s - length if s >= length else s + length if s < 0.0 else s
    elif s > length or s < 0.0:
        s = min(max(s, 0.0), length)
        walker[W_V] = -walker[W_V]
    walker[W_S] = s
    walker[W_SINCE] += abs(walker[W_V]) * seconds


@uncounted
def place_walker(streets: Streets, walker: Array, walk: int) -> None:
    """Set the place of a pedestrian."""
    first, end = streets.walks[walk, 0], streets.walks[walk, 1]
    x, y, ux, uy = point_on(streets.paths, streets.along, first, end, walker[W_S])
    walker[W_SINCE] = 0.0
    walker[W_X], walker[W_Y] = rounded(x - uy * walker[W_ASIDE], 1e3), rounded(y + ux * walker[W_ASIDE], 1e3)
    sign = 1.0 if walker[W_V] >= 0.0 else -1.0
    walker[W_YAW] = float(int(math.atan2(sign * uy, sign * ux) * 1e4)) / 1e4


@uncounted
def note(others: Others, i: int, number: int, square: float, x: float, y: float, yaw: float) -> None:
    """Add a road user to those that an ego sees, in the order of their distance."""
    users, pictures, near = others.users[i], others.pictures[i], others.near[i]
    row = others.seen[i]
    while row > 0 and near[row - 1] > square:
        near[row] = near[row - 1]
        for column in range(USER):
            users[row, column] = users[row - 1, column]
        for column in range(PICTURE):
            pictures[row, column] = pictures[row - 1, column]
        row -= 1
    near[row] = square
    others.seen[i] += 1
    vehicles = others.counts[i, VEHICLES]
    users[row, 0] = pictures[row, 0] = x
    users[row, 1] = pictures[row, 1] = y
    users[row, 2] = pictures[row, 2] = yaw
    if number < vehicles:
        car = others.cars[i, number]
        users[row, 3], users[row, 4], users[row, 5] = car[LENGTH], car[WIDTH], rounded(car[V], 1e3)
        pictures[row, 5], pictures[row, 6], pictures[row, 7] = car[HEIGHT], crowd.VEHICLE_KIND, car[COLOUR]
    else:
        walker = others.walkers[i, number - vehicles]
        users[row, 3] = users[row, 4] = PEDESTRIAN_SIZE
        users[row, 5] = rounded(abs(walker[W_V]), 1e3)
        pictures[row, 5], pictures[row, 6], pictures[row, 7] = walker[W_HEIGHT], crowd.PEDESTRIAN_KIND, walker[W_COLOUR]
    pictures[row, 3] = users[row, 3]
    pictures[row, 4] = users[row, 4]


@uncounted
def look(others: Others, i: int, x: float, y: float) -> None:
    """Find the road users within 80 m of an ego, nearest first."""
    others.seen[i] = 0
    vehicles = others.counts[i, VEHICLES]
    for k in range(vehicles):
        if others.ways[i, k, HERE] != 0:
            car = others.cars[i, k]
            dx, dy = car[X] - x, car[Y] - y
            if dx * dx + dy * dy <= RANGE * RANGE:
                note(others, i, k, dx * dx + dy * dy, car[X], car[Y], car[YAW])
    for k in range(others.counts[i, PEDESTRIANS]):
        walker = others.walkers[i, k]
        dx, dy = walker[W_X] - x, walker[W_Y] - y
        if dx * dx + dy * dy <= RANGE * RANGE:
            note(others, i, vehicles + k, dx * dx + dy * dy, walker[W_X], walker[W_Y], walker[W_YAW])
