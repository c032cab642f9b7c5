"""The other road users of a fleet's egos: where they are, and which of them an ego can see.

Each ego has road users of its own, in its row of every array. They mind their ego and each other and no other ego.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from wrongturn_judge.compiling import record, uncounted, words
from wrongturn_judge.kernels import Array
from wrongturn_sim.fleet.streets import Streets
from wrongturn_sim.guide import Net
from wrongturn_sim.traffic import crowd

TRAFFIC = record("hesitant leaders crossers waiters permitted", "vehicles pedestrians met stood random seen")
"""The traffic of an ego: its shares, as :class:`~wrongturn_sim.fleet.traffic.FleetTraffic` has them; the greatest speed
that it permits the ego, m/s (inf where nobody is in the way). How many cars and pedestrians; the leg at whose end it
was last drawn whether the ego meets a car, and one that stands (-1 before); the state of its random numbers; how many
the ego can see."""
CAR = record(
    "s v a length width height colour likes waited until stands stays x y yaw since",
    "leg gate inside goes here stays_for",
)
"""Metres of its front bumper along its line; speed, m/s; acceleration until the next decision; body; number of its
colour; share of the speed limit that its driver likes; seconds that it has waited at its stop line; seconds until it
stops without need (below 0: it stops), and how long it then stands (0: its driver never does); seconds that it still
stays at its stop line without need; place of its body's centre, and metres driven since the car was there (0, unless
the ego is far away).

Its leg; the exit that it takes at the leg's end (-1: none); whether its line is that exit's path, which leads through
the junction and along the exit's lane; whether the junction is kept free for it; whether it is in town: where a lane
ends at the edge of the town, a car leaves and comes back at an entry; the leg of the ego for whose sake it stays at its
stop line, until the ego has left that leg (-1: none)."""
WALKER = record("s v aside height colour x y yaw since", "walk")
"""Metres along the pavement; speed, m/s, below 0 against the pavement's direction; metres to the left of its line;
height; number of the colour; place, and metres walked since, as for cars. The pavement."""

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

    traffic: Array
    """(n, words): a TRAFFIC for each ego."""
    cars: Array
    """(n, most cars, words): a CAR for each."""
    walkers: Array
    """(n, most pedestrians, words): a WALKER for each."""
    users: Array
    """(n, most, USER): those that the ego can see, nearest first, for the judge."""
    pictures: Array
    """(n, most, PICTURE): the same for pictures."""
    near: Array
    """(n, most): squares of their distances."""
    way: Array
    """(n, SAMPLES, 4): points of the ego's way ahead and the way's unit vectors there."""

    def of(self, name: str) -> Array:
        """Return a field of all egos' traffic, (n,)."""
        return np.asarray(self.traffic.view(TRAFFIC)[name][:, 0])


class Ego(NamedTuple):
    """An ego and all that its road users mind: the rows of one ego, and the town."""

    streets: Streets
    net: Net
    traffic: Array
    """(1,) of TRAFFIC"""
    cars: Array
    """(most cars,) of CAR"""
    walkers: Array
    """(most pedestrians,) of WALKER"""
    users: Array
    pictures: Array
    near: Array
    way: Array
    """As in :class:`Others`."""
    route: Array
    """(1,) of :data:`~wrongturn_sim.guide.PROGRESS`"""
    state: Array
    """(5,), as :data:`~wrongturn_sim.ego.State`."""


def others_for(count: int, vehicles: int, pedestrians: int) -> Others:
    """Return empty arrays for ``count`` egos with at most this many road users each."""
    most = vehicles + pedestrians
    others = Others(
        traffic=np.zeros((count, words(TRAFFIC))),
        cars=np.zeros((count, vehicles, words(CAR))),
        walkers=np.zeros((count, pedestrians, words(WALKER))),
        users=np.zeros((count, most, USER)),
        pictures=np.zeros((count, most, PICTURE)),
        near=np.zeros((count, most)),
        way=np.zeros((count, SAMPLES, 4)),
    )
    others.of("permitted")[:] = np.inf
    return others


@uncounted
def draw(ego: Ego) -> float:
    """Return the next random number of an ego's traffic, from 0 to below 1."""
    traffic = ego.traffic[0]
    state = traffic.random * 6364136223846793005 + 1442695040888963407
    traffic.random = state
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
def point_ahead(net: Net, leg: int, gate: int, inside: int, s: float) -> tuple[float, float, float, float]:
    """Return the point ``s`` metres along a way, and the way's unit vector there.

    Distances count from the start of a leg's lane or, ``inside`` the junction, of its exit's path. Before the path lies
    the leg's lane, after the lane its exit's path.
    """
    lane, path = net.legs[leg], net.gates[leg, gate]
    if inside:
        if s >= 0.0:
            return point_on(net.points, net.along, path.first, path.end, s)
        s += lane.length
    elif s > lane.length and gate >= 0:
        return point_on(net.points, net.along, path.first, path.end, s - lane.length)
    return point_on(net.points, net.along, lane.first, lane.end, s)


@uncounted
def rounded(value: float, per_unit: float) -> float:
    """Return a value rounded as SUMO's road users are, so that both look the same."""
    return math.floor(value * per_unit + 0.5) / per_unit


@uncounted
def place_car(net: Net, car: Any) -> None:
    """Set the place of a car's body: both bumpers are on its line."""
    fx, fy, _, _ = point_ahead(net, car.leg, car.gate, car.inside, car.s)
    bx, by, _, _ = point_ahead(net, car.leg, car.gate, car.inside, car.s - car.length)
    yaw = float(int(math.atan2(fy - by, fx - bx) * 1e4)) / 1e4
    half = 0.5 * car.length
    car.since = 0.0
    car.x, car.y, car.yaw = rounded(fx - half * math.cos(yaw), 1e3), rounded(fy - half * math.sin(yaw), 1e3), yaw


@uncounted
def out_of_sight(user: Any, state: Array) -> bool:
    """Return whether nobody needs to know where a car or walker is now: it is far from where the ego sees."""
    reach = RANGE + user.since + SLACK
    dx, dy = user.x - state[0], user.y - state[1]
    return bool(user.since < OFTEN and dx * dx + dy * dy > reach * reach)


@uncounted
def move_walker(streets: Streets, walker: Any, seconds: float) -> None:
    """Let a pedestrian walk on; at the end of a pavement that is no ring they turn round."""
    end = streets.walks[walker.walk, 1]
    length = streets.along[end - 1]
    s = walker.s + walker.v * seconds
    if streets.walks[walker.walk, 2] != 0:
        s = s - length if s >= length else s + length if s < 0.0 else s
    elif s > length or s < 0.0:
        s = min(max(s, 0.0), length)
        walker.v = -walker.v
    walker.s = s
    walker.since += abs(walker.v) * seconds


@uncounted
def place_walker(streets: Streets, walker: Any) -> None:
    """Set the place of a pedestrian."""
    first, end = streets.walks[walker.walk, 0], streets.walks[walker.walk, 1]
    x, y, ux, uy = point_on(streets.paths, streets.along, first, end, walker.s)
    walker.since = 0.0
    walker.x, walker.y = rounded(x - uy * walker.aside, 1e3), rounded(y + ux * walker.aside, 1e3)
    sign = 1.0 if walker.v >= 0.0 else -1.0
    walker.yaw = float(int(math.atan2(sign * uy, sign * ux) * 1e4)) / 1e4


@uncounted
def note(ego: Ego, user: Any, kind: int, length: float, width: float) -> None:
    """Add a car or walker to those that an ego sees, in the order of their distance, if it is within 80 m."""
    dx, dy = user.x - ego.state[0], user.y - ego.state[1]
    square = dx * dx + dy * dy
    if square > RANGE * RANGE:
        return
    users, pictures, near, traffic = ego.users, ego.pictures, ego.near, ego.traffic[0]
    row = traffic.seen
    while row > 0 and near[row - 1] > square:
        near[row] = near[row - 1]
        for column in range(USER):
            users[row, column] = users[row - 1, column]
        for column in range(PICTURE):
            pictures[row, column] = pictures[row - 1, column]
        row -= 1
    near[row] = square
    traffic.seen += 1
    users[row, 0], users[row, 1], users[row, 2] = user.x, user.y, user.yaw
    users[row, 3], users[row, 4], users[row, 5] = length, width, rounded(abs(user.v), 1e3)
    for column in range(USER - 1):
        pictures[row, column] = users[row, column]
    pictures[row, 5], pictures[row, 6], pictures[row, 7] = user.height, kind, user.colour


@uncounted
def look(ego: Ego) -> None:
    """Find the road users within 80 m of an ego, nearest first."""
    traffic = ego.traffic[0]
    traffic.seen = 0
    for k in range(traffic.vehicles):
        car = ego.cars[k]
        if car.here != 0:
            note(ego, car, crowd.VEHICLE_KIND, car.length, car.width)
    for k in range(traffic.pedestrians):
        note(ego, ego.walkers[k], crowd.PEDESTRIAN_KIND, PEDESTRIAN_SIZE, PEDESTRIAN_SIZE)
