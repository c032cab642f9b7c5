"""The speed that traffic permits an ego: it falls with the gap to whoever is in its way, down to standing.

Training takes it as an upper limit of the speed that the reward asks for. So braking earns reward before a crash costs
any, and a car that waits behind another is not punished for standing.
"""

import math

from wrongturn_judge.compiling import uncounted
from wrongturn_judge.kernels import Array
from wrongturn_sim import guide
from wrongturn_sim.fleet.drivers import safe_speed, time_to
from wrongturn_sim.fleet.ego_ahead import EGO_HALF_LENGTH, EGO_HALF_WIDTH, ego_to_line
from wrongturn_sim.fleet.others import (
    GATE,
    GOES,
    HERE,
    INSIDE,
    LEG,
    LENGTH,
    SAMPLES,
    VEHICLES,
    WIDTH,
    Others,
    S,
    V,
    X,
    Y,
    point_ahead,
)
from wrongturn_sim.fleet.right_of_way import CROSSES, YIELDS
from wrongturn_sim.fleet.streets import Streets

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
def will_cross(
    points: Array, along: Array, legs: Array, lengths: Array, others: Others, i: int, k: int, samples: int
) -> int:
    """Return the first point of the ego's way that a car soon crosses, by its own way; ``samples`` if there is none."""
    car, way = others.cars[i, k], others.ways[i, k]
    found, seconds = samples, MOMENT
    while seconds <= SOON:
        s = car[S] + car[V] * seconds - 0.5 * car[LENGTH]
        x, y, ux, uy = point_ahead(points, along, legs, lengths, way[LEG], way[GATE], way[INSIDE], s)
        for sample in range(found):
            px, py, wx, wy = others.way[i, sample]
            if abs(ux * wx + uy * wy) >= CROSSING:
                continue
            ahead, across = (px - x) * ux + (py - y) * uy, (py - y) * ux - (px - x) * uy
            if abs(ahead) < 0.5 * car[LENGTH] and abs(across) < 0.5 * car[WIDTH] + EGO_HALF_WIDTH + ASIDE:
                found = sample
                break
        seconds += MOMENT
    return found


@uncounted
def way_clear(
    points: Array, along: Array, legs: Array, lengths: Array, others: Others, i: int, progress: Array, places: Array,
    state: Array,
) -> float:  # fmt: skip
    """Return the speed that the road users on the ego's way permit, m/s; inf where there are none."""
    leg, gate, inside = progress[guide.P_LEG], progress[guide.P_GATE], progress[guide.P_INSIDE]
    begin = places[guide.P_S] + EGO_HALF_LENGTH
    if inside:
        at = guide.L_GATE + guide.GATE_INTS * gate
        end = along[legs[leg, at + guide.G_END] - 1]
    else:
        end = lengths[leg, guide.F_LENGTH]
        if gate >= 0:
            at = guide.L_GATE + guide.GATE_INTS * gate
            end += along[legs[leg, at + guide.G_END] - 1]
    # A car that ends a lane at the edge of the town sees less far.
    samples = min(SAMPLES, max(int((end - begin) / STRIDE) + 1, 0))
    way = others.way[i]
    for k in range(samples):
        way[k, 0], way[k, 1], way[k, 2], way[k, 3] = point_ahead(
            points, along, legs, lengths, leg, gate, inside, begin + k * STRIDE
        )
    cos, sin = math.cos(state[2]), math.sin(state[2])
    best = math.inf
    for number in range(others.seen[i]):
        user = others.users[i, number]
        dx, dy = user[0] - state[0], user[1] - state[1]
        reach = AHEAD + EGO_HALF_LENGTH + 0.5 * user[3]
        if dx * dx + dy * dy > reach * reach or dx * cos + dy * sin < -EGO_HALF_LENGTH:
            continue
        for k in range(samples):
            there, speed = on_way(user, way[k, 0], way[k, 1], way[k, 2], way[k, 3])
            if there:
                best = min(best, safe_speed(k * STRIDE - GAP, speed, BRAKING, REACTION))
                break
    for k in range(others.counts[i, VEHICLES]):
        car = others.cars[i, k]
        dx, dy, reach = car[X] - state[0], car[Y] - state[1], AHEAD + EGO_HALF_LENGTH + SOON * car[V] + car[LENGTH]
        goes = others.ways[i, k, HERE] and (others.ways[i, k, INSIDE] or others.ways[i, k, GOES])
        if not goes or car[V] < WAITING or dx * dx + dy * dy > reach * reach:
            continue
        crossed = will_cross(points, along, legs, lengths, others, i, k, samples)
        if crossed < samples:
            best = min(best, safe_speed(crossed * STRIDE - GAP, 0.0, BRAKING, REACTION))
    return best


@uncounted
def junction_clear(
    streets: Streets, lengths: Array, others: Others, i: int, progress: Array, places: Array, state: Array
) -> float:
    """Return the speed towards the stop line that an ego may drive which has to give way there, m/s; else inf."""
    leg, gate = progress[guide.P_LEG], progress[guide.P_GATE]
    if progress[guide.P_INSIDE] or gate < 0:
        return math.inf
    left = ego_to_line(lengths, progress, places)
    if not -1.5 <= left <= AHEAD:
        return math.inf
    inner = lengths[leg, guide.F_GATE + guide.GATE_FLOATS * gate + guide.G_INNER]
    clear = (max(left, 0.0) + inner + 2.0 * EGO_HALF_LENGTH) / max(state[3], 5.0) + 0.5
    ours = 3 * leg + gate
    for k in range(others.counts[i, VEHICLES]):
        way = others.ways[i, k]
        if way[HERE] == 0 or way[GATE] < 0:
            continue
        rule = streets.rules[ours, 3 * way[LEG] + way[GATE]]
        waits = rule & CROSSES and (way[INSIDE] or way[GOES])
        if rule & YIELDS and not waits and not way[INSIDE]:
            away = lengths[way[LEG], guide.F_LENGTH] - others.cars[i, k, S]
            waits = others.cars[i, k, V] > 0.5 and time_to(away, others.cars[i, k, V]) < clear
        if waits:
            return safe_speed(left - 0.5, 0.0, BRAKING, REACTION)
    return math.inf


@uncounted
def permit(
    streets: Streets, points: Array, along: Array, legs: Array, lengths: Array, others: Others, i: int,
    progress: Array, places: Array, state: Array,
) -> float:  # fmt: skip
    """Return the greatest speed that traffic permits an ego, m/s; inf where nobody is in its way."""
    if others.counts[i, VEHICLES] == 0 and others.seen[i] == 0:
        return math.inf
    return min(
        way_clear(points, along, legs, lengths, others, i, progress, places, state),
        junction_clear(streets, lengths, others, i, progress, places, state),
    )
