"""Cars that an ego meets at a junction, for training: without them it has to give way too rarely to learn it."""

from wrongturn_judge.compiling import uncounted
from wrongturn_judge.kernels import Array
from wrongturn_sim import guide
from wrongturn_sim.fleet.drivers import BRAKING, GAP, REACTION, STOP, leader_of, safe_speed
from wrongturn_sim.fleet.ego_ahead import ego_to_line
from wrongturn_sim.fleet.others import (
    FOR,
    GATE,
    GOES,
    HERE,
    INSIDE,
    LEG,
    LENGTH,
    LIKES,
    MEETS,
    RANGE,
    STAYS,
    VEHICLES,
    WAITED,
    A,
    Others,
    S,
    V,
    X,
    Y,
    draw,
    place_car,
)
from wrongturn_sim.fleet.right_of_way import YIELDS
from wrongturn_sim.fleet.streets import Streets

NEAR = 25.0
"""Distance before the stop line, in metres, at which it is drawn whether the ego meets a car."""
MEETING = 0
"""Column of ``Others.junction``."""
SLOWS, CRUISE, TURNS = 15.0, 7.0, 4.5
"""An ego's usual speed up to so many metres before its line, and after, m/s."""
EARLY, SPREAD = -0.5, 3.0
"""The car reaches its stop line EARLY to EARLY + SPREAD seconds before the ego reaches its own."""
APART = 25.0
"""No other car is this near to the car's place in its lane, metres."""


@uncounted
def meet(
    streets: Streets, points: Array, along: Array, legs: Array, lengths: Array, others: Others, i: int,
    progress: Array, places: Array, state: Array,
) -> None:  # fmt: skip
    """Let a car come to the junction ahead of an ego, if this is drawn; once at each junction."""
    leg, gate = progress[guide.P_LEG], progress[guide.P_GATE]
    if not is_drawn(lengths, others, i, progress, places, MEETS, MEETING, NEAR):
        return
    k, found = far_away(others, i, state), crossing_gate(streets, others, i, leg, gate)
    if k < 0 or found < 0:
        return
    car, way = others.cars[i, k], others.ways[i, k]
    seconds = time_to_line(ego_to_line(lengths, progress, places)) - EARLY - SPREAD * draw(others, i)
    speed = car[LIKES] * streets.limits[found // 3]
    length = lengths[found // 3, guide.F_LENGTH]
    s = min(max(length - speed * seconds, car[LENGTH] + APART), length - 2.0 * STOP)
    if not has_room(others, i, found // 3, s):
        return
    put(others, i, k, found // 3, found % 3, s)
    gap, _ = leader_of(legs, lengths, others, i, k)
    room = min(gap - GAP, length - s - STOP)
    car[V] = min(speed, safe_speed(room, 0.0, BRAKING, REACTION))
    place_car(points, along, legs, lengths, car, way)


@uncounted
def is_drawn(
    lengths: Array, others: Others, i: int, progress: Array, places: Array, habit: int, column: int, near: float
) -> bool:
    """Return whether a habit's share of the junctions has the one ahead of an ego.

    It is drawn once at each, ``near`` metres before its line; ``column`` of ``Others.junction`` keeps where it was.
    """
    leg, share = progress[guide.P_LEG], others.habits[i, habit]
    if share == 0.0 or progress[guide.P_GATE] < 0 or progress[guide.P_INSIDE] or others.junction[i, column] == leg:
        return False
    if ego_to_line(lengths, progress, places) > near:
        return False
    others.junction[i, column] = leg
    return bool(draw(others, i) < share)


@uncounted
def time_to_line(left: float) -> float:
    """Return the seconds that an ego usually needs to its stop line, ``left`` metres away."""
    return max(left - SLOWS, 0.0) / CRUISE + min(max(left, 0.0), SLOWS) / TURNS


@uncounted
def has_room(others: Others, i: int, leg: int, s: float) -> bool:
    """Return whether no car is near to a place in a lane, or has leave to drive on from there."""
    for k in range(others.counts[i, VEHICLES]):
        way = others.ways[i, k]
        if way[HERE] and way[LEG] == leg and (way[GOES] or abs(others.cars[i, k, S] - s) < APART):
            return False
    return True


@uncounted
def put(others: Others, i: int, k: int, leg: int, gate: int, s: float) -> None:
    """Move a car into a lane, ``s`` metres along it; it will take that exit."""
    car, way = others.cars[i, k], others.ways[i, k]
    way[LEG], way[GATE], way[INSIDE], way[GOES], way[FOR] = leg, gate, 0, 0, -1
    car[S], car[A], car[WAITED], car[STAYS] = s, 0.0, 0.0, 0.0


@uncounted
def far_away(others: Others, i: int, state: Array) -> int:
    """Return the number of a car that an ego cannot see and that is in no junction; -1 if there is none."""
    for k in range(others.counts[i, VEHICLES]):
        way = others.ways[i, k]
        dx, dy = others.cars[i, k, X] - state[0], others.cars[i, k, Y] - state[1]
        if way[HERE] and not way[INSIDE] and not way[GOES] and dx * dx + dy * dy > 2.0 * RANGE * RANGE:
            return k
    return -1


@uncounted
def crossing_gate(streets: Streets, others: Others, i: int, leg: int, gate: int) -> int:
    """Draw a way through a junction for which the ego on its own way has to wait; -1 if there is none."""
    count, found = 0, -1
    for other in range(len(streets.rules)):
        if other // 3 != leg and streets.rules[3 * leg + gate, other] & YIELDS:
            count += 1
            if draw(others, i) * count < 1.0:
                found = other
    return found
