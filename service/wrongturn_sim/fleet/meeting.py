"""Cars that an ego meets at a junction, for training: else it has to give way and to stop too rarely to learn it.

Some cross the ego's way as it comes. Others stand at a stop line, as if they waited for the right of way: in the ego's
own lane, or in the oncoming lane of the street that its way enters.
"""

from typing import Any

from wrongturn_judge.compiling import uncounted
from wrongturn_sim.fleet import headway
from wrongturn_sim.fleet.drivers import BRAKING, GAP, REACTION, STOP, choose_gate, leader_of, safe_speed
from wrongturn_sim.fleet.ego_ahead import ego_to_line
from wrongturn_sim.fleet.others import RANGE, Ego, draw, place_car
from wrongturn_sim.fleet.streets import YIELDS
from wrongturn_sim.guide import Net

NEAR, NEAR_STANDING = 25.0, 45.0
"""Distance before the stop line, in metres, at which it is drawn whether the ego meets a car, and one that stands."""
SLOWS, CRUISE, TURNS = 15.0, 7.0, 4.5
"""An ego's usual speed up to so many metres before its line, and after, m/s."""
EARLY, SPREAD = -0.5, 3.0
"""The car reaches its stop line EARLY to EARLY + SPREAD seconds before the ego reaches its own."""
APART = 25.0
"""No other car is this near to the car's place in its lane, metres."""
OWN = 0.5
"""Share of the standing cars that stand in the ego's own lane, where there is room."""
LEAST, LONGER = 2.0, 6.0
"""In the ego's lane the car stays so many seconds after the ego can have come, and up to so many more."""
MOST = 30.0
"""Elsewhere it stays for at most so many seconds."""


@uncounted
def meet(ego: Ego) -> None:
    """Let a car come to the junction ahead of an ego, if this is drawn; once at each junction."""
    traffic, route = ego.traffic[0], ego.route[0]
    if not comes_near(ego, traffic.crossers, traffic.met, NEAR):
        return
    traffic.met = route.leg
    if draw(ego) >= traffic.crossers:
        return
    k, found = far_away(ego), crossing_gate(ego)
    if k < 0 or found < 0:
        return
    car, leg = ego.cars[k], found // 3
    seconds = time_to_line(ego_to_line(ego)) - EARLY - SPREAD * draw(ego)
    speed = car.likes * ego.streets.limits[leg]
    length = ego.net.legs[leg].length
    s = min(max(length - speed * seconds, car.length + APART), length - 2.0 * STOP)
    if not has_room(ego, leg, s):
        return
    put(car, leg, found % 3, s)
    gap, _ = leader_of(ego, k)
    room = min(gap - GAP, length - s - STOP)
    car.v = min(speed, safe_speed(room, 0.0, BRAKING, REACTION))
    place_car(ego.net, car)


@uncounted
def wait(ego: Ego) -> None:
    """Let a car stand at the junction ahead of an ego, if this is drawn; once at each junction."""
    traffic, route = ego.traffic[0], ego.route[0]
    if not comes_near(ego, traffic.waiters, traffic.stood, NEAR_STANDING):
        return
    traffic.stood = route.leg
    if draw(ego) >= traffic.waiters:
        return
    k = far_away(ego)
    if k < 0:
        return
    car, left = ego.cars[k], ego_to_line(ego)
    seconds = time_to_line(left) + LEAST + LONGER * draw(ego)
    if draw(ego) < OWN and can_stop(ego, car, left) and stand(ego, car, route.leg):
        car.stays = seconds
    else:
        back = way_back(ego.net, ego.net.gates[route.leg, route.gate].leg)
        if back < 0 or not stand(ego, car, back):
            return
        car.stays, car.stays_for = MOST, route.leg
    place_car(ego.net, car)


@uncounted
def comes_near(ego: Ego, share: float, last: int, near: float) -> bool:
    """Return whether to draw if an ego meets a car at the junction ahead: once, ``near`` metres before its line.

    ``share`` is that of the junctions with such a car; ``last`` is the leg where it was drawn last.
    """
    route = ego.route[0]
    if share == 0.0 or route.gate < 0 or route.inside or last == route.leg:
        return False
    return ego_to_line(ego) <= near


@uncounted
def time_to_line(left: float) -> float:
    """Return the seconds that an ego usually needs to its stop line, ``left`` metres away."""
    return max(left - SLOWS, 0.0) / CRUISE + min(max(left, 0.0), SLOWS) / TURNS


@uncounted
def has_room(ego: Ego, leg: int, s: float) -> bool:
    """Return whether no car is near to a place in a lane, or has leave to drive on from there."""
    for k in range(ego.traffic[0].vehicles):
        car = ego.cars[k]
        if car.here and car.leg == leg and (car.goes or abs(car.s - s) < APART):
            return False
    return True


@uncounted
def put(car: Any, leg: int, gate: int, s: float) -> None:
    """Move a car into a lane, ``s`` metres along it; it will take that exit."""
    car.leg, car.gate, car.inside, car.goes, car.stays_for = leg, gate, 0, 0, -1
    car.s, car.a, car.waited, car.stays = s, 0.0, 0.0, 0.0


@uncounted
def far_away(ego: Ego) -> int:
    """Return the number of a car that an ego cannot see and that is in no junction; -1 if there is none."""
    for k in range(ego.traffic[0].vehicles):
        car = ego.cars[k]
        dx, dy = car.x - ego.state[0], car.y - ego.state[1]
        if car.here and not car.inside and not car.goes and dx * dx + dy * dy > 2.0 * RANGE * RANGE:
            return k
    return -1


@uncounted
def crossing_gate(ego: Ego) -> int:
    """Draw a way through a junction for which the ego on its own way has to wait; -1 if there is none."""
    leg, rules = ego.route[0].leg, ego.streets.rules
    ours = 3 * leg + ego.route[0].gate
    count, found = 0, -1
    for other in range(len(rules)):
        if other // 3 != leg and rules[ours, other] & YIELDS:
            count += 1
            if draw(ego) * count < 1.0:
                found = other
    return found


@uncounted
def can_stop(ego: Ego, car: Any, left: float) -> bool:
    """Return whether an ego can stop in comfort behind a car at its stop line, ``left`` metres away."""
    gap = left - STOP - car.length - headway.GAP
    return bool(gap > 0.0 and ego.state[3] <= safe_speed(gap, 0.0, headway.BRAKING, headway.REACTION))


@uncounted
def stand(ego: Ego, car: Any, leg: int) -> bool:
    """Move a car to a stop line; return False where another car is near."""
    s = ego.net.legs[leg].length - STOP
    if s < car.length or not has_room(ego, leg, s):
        return False
    put(car, leg, -1, s)
    choose_gate(ego, car)
    car.v = 0.0
    return True


@uncounted
def way_back(net: Net, onward: int) -> int:
    """Return the leg that leads out of a street into which a leg leads; -1 if there is none."""
    for leg in range(len(net.legs)):
        if net.legs[leg].approach and net.legs[leg].back == onward:
            return leg
    return -1
