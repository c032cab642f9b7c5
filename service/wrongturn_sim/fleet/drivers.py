"""The drivers of a fleet's traffic: they keep their distance, give way, and let one car after the other cross.

They drive like SUMO's (Krauss' model with its usual numbers). A junction is kept free for a car before it enters: no
two cars whose ways cross are in it at once. The ego does not ask, so others look whether it is in their way, and brake
for it where it is in the junction first.
"""

import math
from typing import Any

from wrongturn_judge.compiling import uncounted
from wrongturn_protocol.vehicle import DECISION_S
from wrongturn_sim.fleet.ego_ahead import FAR, ego_crosses, ego_to_line, gap_to_ego, gap_to_merging_ego
from wrongturn_sim.fleet.others import Ego, draw, move_walker, out_of_sight, place_car, place_walker
from wrongturn_sim.fleet.streets import CROSSES, YIELDS

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
def leader_of(ego: Ego, k: int) -> tuple[float, float]:
    """Return the gap to the next car on a car's way, metres, and that car's speed; FAR if there is none."""
    car = ego.cars[k]
    onward, inner = -1, 0.0
    if car.gate >= 0:
        onward, inner = ego.net.gates[car.leg, car.gate].leg, ego.net.gates[car.leg, car.gate].inner
    # Metres from the car to the start of its exit's path.
    ahead = -car.s if car.inside else ego.net.legs[car.leg].length - car.s
    best, speed = FAR, 0.0
    for j in range(ego.traffic[0].vehicles):
        other = ego.cars[j]
        if j == k or other.here == 0:
            continue
        if other.leg == car.leg:
            if other.inside == car.inside:
                gap = other.s - car.s
                if gap == 0.0 and j > k:
                    continue
            elif other.inside:
                gap = ahead + other.s
            else:
                continue
        elif other.leg == onward and not other.inside:
            gap = ahead + inner + other.s
        else:
            continue
        if gap < 0.0:
            continue
        gap -= other.length
        if gap < best:
            best, speed = gap, other.v
    return best, speed


@uncounted
def time_to(metres: float, speed: float) -> float:
    """Return the seconds that a car needs for a distance at its speed, at least 3 m/s."""
    return max(metres, 0.0) / max(speed, 3.0)


@uncounted
def brake_for_ego(ego: Ego, car: Any, left: float) -> float:
    """Return the speed of a car that has leave to enter the junction ahead, where the ego may be in its way, m/s.

    As in SUMO, the right of way ends where somebody is in the junction already.
    """
    if not ego_crosses(ego, car):
        return FAR
    if car.v * car.v < 2.0 * EMERGENCY * (left - STOP):
        car.goes = 0  # it can stop, so others may go before it
    return safe_speed(left - STOP, 0.0, BRAKING, REACTION)


@uncounted
def may_go(ego: Ego, k: int) -> bool:
    """Return whether a car may enter the junction ahead."""
    car, net, streets = ego.cars[k], ego.net, ego.streets
    ours, gate = 3 * car.leg + car.gate, net.gates[car.leg, car.gate]
    left = net.legs[car.leg].length - car.s
    if left > VISIBLE and streets.minor[ours]:
        return False
    # When the car's rear is out of the junction, and a second more.
    clear = (left + gate.inner + car.length) / max(car.v, 5.0) + 1.0
    for j in range(ego.traffic[0].vehicles):
        other = ego.cars[j]
        if j == k or other.here == 0:
            continue
        if other.leg == gate.leg and not other.inside:
            room = other.s - other.length
            if room < car.length + GAP and other.v < 2.0:
                return False
        if other.gate < 0:
            continue
        rule = streets.rules[ours, 3 * other.leg + other.gate]
        if rule & CROSSES and (other.inside or other.goes):
            return False
        if rule & YIELDS and not other.inside and other.stays <= 0.0 and car.waited < PATIENCE:
            away = net.legs[other.leg].length - other.s
            if time_to(away, other.v) < clear:
                return False
    route, speed = ego.route[0], ego.state[3]
    if route.gate < 0:
        return True
    if ego_crosses(ego, car):
        return False
    rule = streets.rules[ours, 3 * route.leg + route.gate]
    waits = speed > 0.5 or car.waited < EGO_PATIENCE
    return bool(route.inside or not (rule & YIELDS and waits and time_to(ego_to_line(ego), speed) < clear))


@uncounted
def stays(ego: Ego, car: Any) -> bool:
    """Return whether a driver stays at the stop line without need."""
    if car.stays_for >= 0 and car.stays_for != ego.route[0].leg:
        car.stays = 0.0
    if car.stays <= 0.0:
        return False
    car.stays -= DECISION_S
    return True


@uncounted
def hesitate(ego: Ego, car: Any, left: float, wanted: float) -> float:
    """Return the speed of a driver who stops now and then without need; other drivers keep the wanted speed."""
    if car.stands <= 0.0:
        return wanted
    if car.until > 0.0:
        car.until -= DECISION_S
        if car.until <= 0.0 and (left < 12.0 or car.inside):
            car.until = 1.0  # not in a junction, nor right before it
        return wanted
    if car.v < 0.1:
        car.until -= DECISION_S
        if car.until < -car.stands:
            car.until = 6.0 + 14.0 * draw(ego)
    return float(max(0.0, min(wanted, car.v - BRAKING * DECISION_S)))


@uncounted
def speed_for_gate(ego: Ego, k: int, left: float, wanted: float) -> float:
    """Return the speed that the turn and the right of way allow at the end of a car's lane, m/s, at most as wanted."""
    car, net = ego.cars[k], ego.net
    gate, turning = net.gates[car.leg, car.gate], ego.streets.speeds[3 * car.leg + car.gate]
    if car.inside:
        if car.s < gate.inner:
            wanted = min(wanted, turning)
        ahead = gate.inner - car.s
    else:
        wanted = min(wanted, math.sqrt(turning * turning + 2.0 * GENTLE * max(left, 0.0)))
        ahead = left + gate.inner
    # Whatever comes, the car can stop at the end of the lane after the junction.
    onward = net.legs[gate.leg]
    if onward.approach:
        wanted = min(wanted, safe_speed(ahead + onward.length - STOP, 0.0, BRAKING, REACTION))
    if not car.inside and car.goes:
        wanted = min(wanted, brake_for_ego(ego, car, left))
    if not car.inside and not car.goes:
        room = safe_speed(left - STOP, 0.0, BRAKING, REACTION)
        if room < car.v + ACCELERATION * DECISION_S + 2.0:
            if not stays(ego, car) and may_go(ego, k):
                car.goes, car.waited = 1, 0.0
            else:
                wanted = min(wanted, room)
                if car.v < 0.5 and left < 6.0:
                    car.waited += DECISION_S
    return float(wanted)


@uncounted
def decide_speed(ego: Ego, k: int) -> float:
    """Return the speed that a driver wants after the next decision, m/s."""
    car, v = ego.cars[k], ego.cars[k].v
    # To the next stop line that it has not got leave to pass.
    left = FAR if car.inside else ego.net.legs[car.leg].length - car.s
    wanted = min(car.likes * ego.streets.limits[car.leg], v + ACCELERATION * DECISION_S)
    if car.gate >= 0:
        wanted = speed_for_gate(ego, k, left, wanted)
    gap, speed = leader_of(ego, k)
    wanted = min(wanted, safe_speed(gap - GAP, speed, BRAKING, REACTION))
    gap, speed = gap_to_ego(ego, car, v * REACTION + v * v / (2.0 * BRAKING) + 8.0)
    wanted = min(wanted, safe_speed(gap - GAP, speed, BRAKING, REACTION))
    gap = gap_to_merging_ego(ego, car)
    wanted = min(wanted, safe_speed(gap - GAP, ego.state[3], BRAKING, REACTION))
    wanted = hesitate(ego, car, left, wanted)
    return max(0.0, wanted - IMPERFECTION * ACCELERATION * DECISION_S * draw(ego))


@uncounted
def choose_gate(ego: Ego, car: Any) -> None:
    """Draw the exit that a car takes at the end of its lane."""
    gates = ego.net.legs[car.leg].gates
    car.gate = int(draw(ego) * gates) if gates > 0 else -1


@uncounted
def come_back(ego: Ego, car: Any) -> None:
    """Let a car that left the town come in at an entry, if there is room."""
    leg = ego.streets.entries[int(draw(ego) * len(ego.streets.entries))]
    for j in range(ego.traffic[0].vehicles):
        other = ego.cars[j]
        if other.here and other.leg == leg and other.s < ENTRY:
            return
    begin = ego.net.legs[leg].first
    dx, dy = ego.net.points[begin, 0] - ego.state[0], ego.net.points[begin, 1] - ego.state[1]
    if dx * dx + dy * dy < ENTRY * ENTRY:
        return
    car.leg, car.inside, car.goes, car.here = leg, 0, 0, 1
    car.s, car.v, car.a, car.waited = car.length + STOP, 5.0, 0.0, 0.0
    choose_gate(ego, car)
    place_car(ego.net, car)


@uncounted
def think(ego: Ego) -> None:
    """Let the drivers around an ego decide on their acceleration."""
    for k in range(ego.traffic[0].vehicles):
        car = ego.cars[k]
        if car.here == 0:
            come_back(ego, car)
        if car.here:
            car.a = max((decide_speed(ego, k) - car.v) / DECISION_S, -EMERGENCY)


@uncounted
def move(ego: Ego, seconds: float) -> None:
    """Move an ego's road users for a sub-step."""
    for k in range(ego.traffic[0].vehicles):
        car = ego.cars[k]
        if car.here == 0:
            continue
        car.v = max(0.0, car.v + car.a * seconds)
        car.s += car.v * seconds
        car.since += car.v * seconds
        length = ego.net.legs[car.leg].length
        if car.inside:
            gate = ego.net.gates[car.leg, car.gate]
            if car.s >= gate.inner + car.length:
                car.s -= gate.inner
                car.leg, car.inside, car.goes = gate.leg, 0, 0
                choose_gate(ego, car)
        elif car.s >= length:
            if car.gate < 0:
                car.here = 0
                continue
            car.s -= length
            car.inside = 1
        if not out_of_sight(car, ego.state):
            place_car(ego.net, car)
    for k in range(ego.traffic[0].pedestrians):
        walker = ego.walkers[k]
        move_walker(ego.streets, walker, seconds)
        if not out_of_sight(walker, ego.state):
            place_walker(ego.streets, walker)
