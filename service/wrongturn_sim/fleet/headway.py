"""The speed that traffic permits an ego: it falls with the gap to whoever is in its way, down to standing.

Training takes it as an upper limit of the speed that the reward asks for. So braking earns reward before a crash costs
any, and a car that waits behind another is not punished for standing.
"""

import math
from typing import Any

from wrongturn_judge.compiling import uncounted
from wrongturn_judge.kernels import Array
from wrongturn_sim.fleet.drivers import safe_speed, time_to
from wrongturn_sim.fleet.ego_ahead import EGO_HALF_LENGTH, EGO_HALF_WIDTH, ego_to_line
from wrongturn_sim.fleet.others import SAMPLES, Ego, point_ahead
from wrongturn_sim.fleet.streets import CROSSES, YIELDS

STRIDE = 1.0
"""Distance between the points that are checked, metres."""
AHEAD = STRIDE * (SAMPLES - 1)
"""Length of the ego's way that is checked, metres from its front."""
GAP = 4.0
"""Gap at which the ego should stand, metres."""
BRAKING = 3.0
"""Deceleration with which it should brake, m/s²."""
REACTION = 0.5
"""Seconds."""
ASIDE = 0.25
"""The ego should keep this far away from others on either side, metres."""
SOON, MOMENT = 2.0, 0.25
"""A car that crosses the ego's way is in the way as far as it drives in this time, seconds; looked at in such steps."""
CROSSING = 0.8
"""Others whose direction has a cosine below this with the way's, either way round, cross it."""
WAITING = 1.5
"""An ego that may drive no faster may stand, m/s."""


@uncounted
def on_way(user: Array, px: float, py: float, ux: float, uy: float) -> tuple[bool, float]:
    """Return whether a road user is at a point of the ego's way, and its speed along the way."""
    cos, sin = math.cos(user[2]), math.sin(user[2])
    dx, dy = px - user[0], py - user[1]
    along, across = dx * cos + dy * sin, dy * cos - dx * sin
    if abs(along) < 0.5 * user[3] and abs(across) < 0.5 * user[4] + EGO_HALF_WIDTH + ASIDE:
        return True, max(0.0, user[5] * (cos * ux + sin * uy))
    return False, 0.0


@uncounted
def will_cross(ego: Ego, car: Any, samples: int) -> int:
    """Return the first point of the ego's way that a car soon crosses, by its own way; ``samples`` if there is none."""
    found, seconds = samples, MOMENT
    while seconds <= SOON:
        s = car.s + car.v * seconds - 0.5 * car.length
        x, y, ux, uy = point_ahead(ego.net, car.leg, car.gate, car.inside, s)
        for sample in range(found):
            px, py, wx, wy = ego.way[sample]
            if abs(ux * wx + uy * wy) >= CROSSING:
                continue
            ahead, across = (px - x) * ux + (py - y) * uy, (py - y) * ux - (px - x) * uy
            if abs(ahead) < 0.5 * car.length and abs(across) < 0.5 * car.width + EGO_HALF_WIDTH + ASIDE:
                found = sample
                break
        seconds += MOMENT
    return found


@uncounted
def find_way(ego: Ego) -> int:
    """Fill the points of an ego's way ahead, and return their number."""
    route, net, way = ego.route[0], ego.net, ego.way
    begin = route.s + EGO_HALF_LENGTH
    end = 0.0 if route.inside else net.legs[route.leg].length
    if route.inside or route.gate >= 0:
        end += net.along[net.gates[route.leg, route.gate].end - 1]
    # A car that ends a lane at the edge of the town sees less far.
    samples = min(SAMPLES, max(int((end - begin) / STRIDE) + 1, 0))
    for k in range(samples):
        way[k, 0], way[k, 1], way[k, 2], way[k, 3] = point_ahead(
            net, route.leg, route.gate, route.inside, begin + k * STRIDE
        )
    return samples


@uncounted
def way_clear(ego: Ego) -> float:
    """Return the speed that the road users on the ego's way permit, m/s; inf where there are none."""
    samples = find_way(ego)
    way, state = ego.way, ego.state
    cos, sin = math.cos(state[2]), math.sin(state[2])
    best = math.inf
    for number in range(ego.traffic[0].seen):
        user = ego.users[number]
        dx, dy = user[0] - state[0], user[1] - state[1]
        reach = AHEAD + EGO_HALF_LENGTH + 0.5 * user[3]
        if dx * dx + dy * dy > reach * reach or dx * cos + dy * sin < -EGO_HALF_LENGTH:
            continue
        for k in range(samples):
            there, speed = on_way(user, way[k, 0], way[k, 1], way[k, 2], way[k, 3])
            if there:
                best = min(best, safe_speed(k * STRIDE - GAP, speed, BRAKING, REACTION))
                break
    for k in range(ego.traffic[0].vehicles):
        car = ego.cars[k]
        dx, dy, reach = car.x - state[0], car.y - state[1], AHEAD + EGO_HALF_LENGTH + SOON * car.v + car.length
        goes = car.here and (car.inside or car.goes)
        if not goes or car.v < WAITING or dx * dx + dy * dy > reach * reach:
            continue
        crossed = will_cross(ego, car, samples)
        if crossed < samples:
            best = min(best, safe_speed(crossed * STRIDE - GAP, 0.0, BRAKING, REACTION))
    return best


@uncounted
def junction_clear(ego: Ego) -> float:
    """Return the speed towards the stop line that an ego may drive which has to give way there, m/s; else inf."""
    route, net = ego.route[0], ego.net
    if route.inside or route.gate < 0:
        return math.inf
    left = ego_to_line(ego)
    if not -1.5 <= left <= AHEAD:
        return math.inf
    inner = net.gates[route.leg, route.gate].inner
    clear = (max(left, 0.0) + inner + 2.0 * EGO_HALF_LENGTH) / max(ego.state[3], 5.0) + 0.5
    for k in range(ego.traffic[0].vehicles):
        car = ego.cars[k]
        if car.here == 0 or car.gate < 0:
            continue
        rule = ego.streets.rules[3 * route.leg + route.gate, 3 * car.leg + car.gate]
        waits = rule & CROSSES and (car.inside or car.goes)
        if rule & YIELDS and not waits and not car.inside:
            waits = car.v > 0.5 and time_to(net.legs[car.leg].length - car.s, car.v) < clear
        if waits:
            return safe_speed(left - 0.5, 0.0, BRAKING, REACTION)
    return math.inf


@uncounted
def permit(ego: Ego) -> float:
    """Return the greatest speed that traffic permits an ego, m/s; inf where nobody is in its way."""
    if ego.traffic[0].vehicles == 0 and ego.traffic[0].seen == 0:
        return math.inf
    return min(way_clear(ego), junction_clear(ego))
