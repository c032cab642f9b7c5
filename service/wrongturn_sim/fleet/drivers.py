"""The drivers of a fleet's traffic: they keep their distance, give way, and let one car after the other cross.

They drive like SUMO's (Krauss' model with its usual numbers). A junction is kept free for a car before it enters: no
two cars whose ways cross are in it at once. The ego does not ask, so others look whether it is in their way, and brake
for it where it is in the junction first.
"""

import math

from wrongturn_judge.compiling import uncounted
from wrongturn_judge.kernels import Array
from wrongturn_sim import guide
from wrongturn_sim.fleet.ego_ahead import FAR, ego_crosses, ego_to_line, gap_to_ego, gap_to_merging_ego
from wrongturn_sim.fleet.others import (
    FOR,
    GATE,
    GOES,
    HERE,
    INSIDE,
    LEG,
    LENGTH,
    LIKES,
    PEDESTRIANS,
    SINCE,
    STANDS,
    STAYS,
    UNTIL,
    VEHICLES,
    W_SINCE,
    W_X,
    W_Y,
    WAITED,
    A,
    Others,
    S,
    V,
    X,
    Y,
    draw,
    move_walker,
    out_of_sight,
    place_car,
    place_walker,
)
from wrongturn_sim.fleet.right_of_way import CROSSES, YIELDS
from wrongturn_sim.fleet.streets import Streets

ACCELERATION = 2.6
"""m/s²; this and the next five are SUMO's defaults."""
BRAKING = 4.5
"""Deceleration that drivers count on, m/s²."""
EMERGENCY = 9.0
"""Greatest deceleration, m/s²."""
REACTION = 1.0
"""Seconds."""
GAP = 2.5
"""Distance between standing cars, metres."""
IMPERFECTION = 0.5
"""A driver wastes up to this share of the acceleration."""
GENTLE = 3.0
"""Deceleration before a turn, m/s²."""
STOP = 1.0
"""Cars stop this far before their line, metres."""
DECISION = 0.1
"""Seconds between decisions."""
VISIBLE = 4.5
"""Drivers who have to give way see the others from this far before their line, metres."""
PATIENCE = 8.0
"""After so many seconds at the line a driver no longer waits for cars that only have the right of way, s."""
EGO_PATIENCE = 3.0
"""The same for an ego that stands before the junction."""
ENTRY = 30.0
"""A car comes back to the town where nobody is within this distance, metres."""


@uncounted
def safe_speed(gap: float, leader: float, braking: float, reaction: float) -> float:
    """Return the speed at which a car can stop behind a leader (its speed in m/s) that brakes now, m/s."""
    if gap <= 0.0:
        return 0.0
    delay = reaction * braking
    return math.sqrt(delay * delay + leader * leader + 2.0 * braking * gap) - delay


@uncounted
def left_to_line(lengths: Array, car: Array, way: Array) -> float:
    """Return a car's distance to the next stop line that it has not got leave to pass, metres."""
    if way[INSIDE] == 0:
        return float(lengths[way[LEG], guide.F_LENGTH] - car[S])
    return FAR


@uncounted
def leader_of(legs: Array, lengths: Array, others: Others, i: int, k: int) -> tuple[float, float]:
    """Return the gap to the next car on a car's way, metres, and that car's speed; FAR if there is none."""
    car, way = others.cars[i, k], others.ways[i, k]
    leg, gate, s = way[LEG], way[GATE], car[S]
    length = lengths[leg, guide.F_LENGTH]
    onward, inner = -1, 0.0
    if gate >= 0:
        onward = legs[leg, guide.L_GATE + guide.GATE_INTS * gate + guide.G_LEG]
        inner = lengths[leg, guide.F_GATE + guide.GATE_FLOATS * gate + guide.G_INNER]
    # Metres from the car to the start of its exit's path.
    ahead = -s if way[INSIDE] else length - s
    best, speed = FAR, 0.0
    for j in range(others.counts[i, VEHICLES]):
        other = others.ways[i, j]
        if j == k or other[HERE] == 0:
            continue
        at = others.cars[i, j, S]
        if other[LEG] == leg:
            if other[INSIDE] == way[INSIDE]:
                gap = at - s
                if gap == 0.0 and j > k:
                    continue
            elif other[INSIDE]:
                gap = ahead + at
            else:
                continue
        elif other[LEG] == onward and not other[INSIDE]:
            gap = ahead + inner + at
        else:
            continue
        if gap < 0.0:
            continue
        gap -= others.cars[i, j, LENGTH]
        if gap < best:
            best, speed = gap, others.cars[i, j, V]
    return best, speed


@uncounted
def time_to(metres: float, speed: float) -> float:
    """Return the seconds that a car needs for a distance at its speed, at least 3 m/s."""
    return max(metres, 0.0) / max(speed, 3.0)


@uncounted
def brake_for_ego(
    streets: Streets, lengths: Array, others: Others, i: int, k: int, progress: Array, places: Array, left: float
) -> float:
    """Return the speed of a car that has leave to enter the junction ahead, where the ego may be in its way, m/s.

    As in SUMO, the right of way ends where somebody is in the junction already.
    """
    car, way = others.cars[i, k], others.ways[i, k]
    if not ego_crosses(streets, lengths, way, progress, places):
        return FAR
    if car[V] * car[V] < 2.0 * EMERGENCY * (left - STOP):
        way[GOES] = 0  # it can stop, so others may go before it
    return safe_speed(left - STOP, 0.0, BRAKING, REACTION)


@uncounted
def may_go(
    streets: Streets, legs: Array, lengths: Array, others: Others, i: int, k: int, progress: Array, places: Array,
    state: Array,
) -> bool:  # fmt: skip
    """Return whether a car may enter the junction ahead."""
    car, way = others.cars[i, k], others.ways[i, k]
    leg, gate = way[LEG], way[GATE]
    ours = 3 * leg + gate
    onward = legs[leg, guide.L_GATE + guide.GATE_INTS * gate + guide.G_LEG]
    inner = lengths[leg, guide.F_GATE + guide.GATE_FLOATS * gate + guide.G_INNER]
    left = lengths[leg, guide.F_LENGTH] - car[S]
    if left > VISIBLE and streets.minor[ours]:
        return False
    # When the car's rear is out of the junction, and a second more.
    clear = (left + inner + car[LENGTH]) / max(car[V], 5.0) + 1.0
    for j in range(others.counts[i, VEHICLES]):
        other = others.ways[i, j]
        if j == k or other[HERE] == 0:
            continue
        if other[LEG] == onward and not other[INSIDE]:
            room = others.cars[i, j, S] - others.cars[i, j, LENGTH]
            if room < car[LENGTH] + GAP and others.cars[i, j, V] < 2.0:
                return False
        if other[GATE] < 0:
            continue
        rule = streets.rules[ours, 3 * other[LEG] + other[GATE]]
        if rule & CROSSES and (other[INSIDE] or other[GOES]):
            return False
        if rule & YIELDS and not other[INSIDE] and others.cars[i, j, STAYS] <= 0.0 and car[WAITED] < PATIENCE:
            away = lengths[other[LEG], guide.F_LENGTH] - others.cars[i, j, S]
            if time_to(away, others.cars[i, j, V]) < clear:
                return False
    if progress[guide.P_GATE] < 0:
        return True
    if ego_crosses(streets, lengths, way, progress, places):
        return False
    rule = streets.rules[ours, 3 * progress[guide.P_LEG] + progress[guide.P_GATE]]
    away = ego_to_line(lengths, progress, places)
    waits = state[3] > 0.5 or car[WAITED] < EGO_PATIENCE
    return bool(progress[guide.P_INSIDE] or not (rule & YIELDS and waits and time_to(away, state[3]) < clear))


@uncounted
def stays(others: Others, i: int, k: int, progress: Array) -> bool:
    """Return whether a driver stays at the stop line without need."""
    car, way = others.cars[i, k], others.ways[i, k]
    if way[FOR] >= 0 and way[FOR] != progress[guide.P_LEG]:
        car[STAYS] = 0.0
    if car[STAYS] <= 0.0:
        return False
    car[STAYS] -= DECISION
    return True


@uncounted
def hesitate(others: Others, i: int, k: int, left: float, wanted: float) -> float:
    """Return the speed of a driver who stops now and then without need; other drivers keep the wanted speed."""
    car = others.cars[i, k]
    if car[STANDS] <= 0.0:
        return wanted
    if car[UNTIL] > 0.0:
        car[UNTIL] -= DECISION
        if car[UNTIL] <= 0.0 and (left < 12.0 or others.ways[i, k, INSIDE]):
            car[UNTIL] = 1.0  # not in a junction, nor right before it
        return wanted
    if car[V] < 0.1:
        car[UNTIL] -= DECISION
        if car[UNTIL] < -car[STANDS]:
            car[UNTIL] = 6.0 + 14.0 * draw(others, i)
    return float(max(0.0, min(wanted, car[V] - BRAKING * DECISION)))


@uncounted
def decide_speed(
    streets: Streets, points: Array, along: Array, legs: Array, lengths: Array, others: Others, i: int, k: int,
    progress: Array, places: Array, state: Array,
) -> float:  # fmt: skip
    """Return the speed that a driver wants after the next decision, m/s."""
    car, way = others.cars[i, k], others.ways[i, k]
    leg, gate, v = way[LEG], way[GATE], car[V]
    left = left_to_line(lengths, car, way)
    wanted = min(car[LIKES] * streets.limits[leg], v + ACCELERATION * DECISION)
    if gate >= 0:
        at = guide.F_GATE + guide.GATE_FLOATS * gate
        inner = lengths[leg, at + guide.G_INNER]
        turning = streets.speeds[3 * leg + gate]
        if way[INSIDE]:
            if car[S] < inner:
                wanted = min(wanted, turning)
            ahead = inner - car[S]
        else:
            wanted = min(wanted, math.sqrt(turning * turning + 2.0 * GENTLE * max(left, 0.0)))
            ahead = left + inner
        # Whatever comes, the car can stop at the end of the lane after the junction.
        onward = legs[leg, guide.L_GATE + guide.GATE_INTS * gate + guide.G_LEG]
        if legs[onward, guide.L_APPROACH]:
            wanted = min(wanted, safe_speed(ahead + lengths[onward, guide.F_LENGTH] - STOP, 0.0, BRAKING, REACTION))
        if not way[INSIDE] and way[GOES]:
            wanted = min(wanted, brake_for_ego(streets, lengths, others, i, k, progress, places, left))
        if not way[INSIDE] and not way[GOES]:
            room = safe_speed(left - STOP, 0.0, BRAKING, REACTION)
            if room < v + ACCELERATION * DECISION + 2.0:
                if not stays(others, i, k, progress) and may_go(
                    streets, legs, lengths, others, i, k, progress, places, state
                ):
                    way[GOES] = 1
                    car[WAITED] = 0.0
                else:
                    wanted = min(wanted, room)
                    if v < 0.5 and left < 6.0:
                        car[WAITED] += DECISION
    gap, speed = leader_of(legs, lengths, others, i, k)
    wanted = min(wanted, safe_speed(gap - GAP, speed, BRAKING, REACTION))
    reach = v * REACTION + v * v / (2.0 * BRAKING) + 8.0
    gap, speed = gap_to_ego(points, along, legs, lengths, others, i, k, reach, state)
    wanted = min(wanted, safe_speed(gap - GAP, speed, BRAKING, REACTION))
    gap = gap_to_merging_ego(legs, lengths, others, i, k, progress, places)
    wanted = min(wanted, safe_speed(gap - GAP, state[3], BRAKING, REACTION))
    wanted = hesitate(others, i, k, left, wanted)
    return max(0.0, wanted - IMPERFECTION * ACCELERATION * DECISION * draw(others, i))


@uncounted
def choose_gate(legs: Array, others: Others, i: int, k: int) -> None:
    """Draw the exit that a car takes at the end of its lane."""
    way = others.ways[i, k]
    gates = legs[way[LEG], guide.L_GATES]
    way[GATE] = int(draw(others, i) * gates) if gates > 0 else -1


@uncounted
def come_back(
    streets: Streets, points: Array, along: Array, legs: Array, lengths: Array, others: Others, i: int, k: int,
    state: Array,
) -> None:  # fmt: skip
    """Let a car that left the town come in at an entry, if there is room."""
    car, way = others.cars[i, k], others.ways[i, k]
    leg = streets.entries[int(draw(others, i) * len(streets.entries))]
    for j in range(others.counts[i, VEHICLES]):
        other = others.ways[i, j]
        if other[HERE] and other[LEG] == leg and others.cars[i, j, S] < ENTRY:
            return
    dx, dy = points[legs[leg, guide.L_FIRST], 0] - state[0], points[legs[leg, guide.L_FIRST], 1] - state[1]
    if dx * dx + dy * dy < ENTRY * ENTRY:
        return
    way[LEG], way[INSIDE], way[GOES], way[HERE] = leg, 0, 0, 1
    car[S], car[V], car[A], car[WAITED] = car[LENGTH] + STOP, 5.0, 0.0, 0.0
    choose_gate(legs, others, i, k)
    place_car(points, along, legs, lengths, car, way)


@uncounted
def think(
    streets: Streets, points: Array, along: Array, legs: Array, lengths: Array, others: Others, i: int,
    progress: Array, places: Array, state: Array,
) -> None:  # fmt: skip
    """Let the drivers around an ego decide on their acceleration."""
    for k in range(others.counts[i, VEHICLES]):
        if others.ways[i, k, HERE] == 0:
            come_back(streets, points, along, legs, lengths, others, i, k, state)
        if others.ways[i, k, HERE]:
            car = others.cars[i, k]
            wanted = decide_speed(
                streets, points, along, legs, lengths, others, i, k, progress, places, state
            )  # fmt: skip
            car[A] = max((wanted - car[V]) / DECISION, -EMERGENCY)


@uncounted
def move(
    streets: Streets, points: Array, along: Array, legs: Array, lengths: Array, others: Others, i: int, state: Array,
    seconds: float,
) -> None:  # fmt: skip
    """Move an ego's road users for a sub-step."""
    for k in range(others.counts[i, VEHICLES]):
        car, way = others.cars[i, k], others.ways[i, k]
        if way[HERE] == 0:
            continue
        car[V] = max(0.0, car[V] + car[A] * seconds)
        car[S] += car[V] * seconds
        car[SINCE] += car[V] * seconds
        leg, gate = way[LEG], way[GATE]
        length = lengths[leg, guide.F_LENGTH]
        if way[INSIDE]:
            inner = lengths[leg, guide.F_GATE + guide.GATE_FLOATS * gate + guide.G_INNER]
            if car[S] >= inner + car[LENGTH]:
                car[S] -= inner
                way[LEG] = legs[leg, guide.L_GATE + guide.GATE_INTS * gate + guide.G_LEG]
                way[INSIDE] = way[GOES] = 0
                choose_gate(legs, others, i, k)
        elif car[S] >= length:
            if gate < 0:
                way[HERE] = 0
                continue
            car[S] -= length
            way[INSIDE] = 1
        if not out_of_sight(car[X], car[Y], car[SINCE], state):
            place_car(points, along, legs, lengths, car, way)
    for k in range(others.counts[i, PEDESTRIANS]):
        walker, walk = others.walkers[i, k], others.walks[i, k]
        move_walker(streets, walker, walk, seconds)
        if not out_of_sight(walker[W_X], walker[W_Y], walker[W_SINCE], state):
            place_walker(streets, walker, walk)
