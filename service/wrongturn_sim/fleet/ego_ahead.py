"""The ego in the way of a fleet's car: how far away it is, and whether it is in the junction ahead."""

import math
from typing import Any

from wrongturn_judge.compiling import uncounted
from wrongturn_protocol.vehicle import VEHICLE
from wrongturn_sim.fleet.others import Ego, point_ahead
from wrongturn_sim.fleet.streets import CROSSES

MARGIN = 0.3
"""Drivers brake for an ego whose body is this near to their own car's way, metres."""
STRIDE = 1.5
"""Distance between the points of its way that a driver checks for the ego, metres."""
FAR = 1e9
"""Stands for a gap, in metres, or for a speed, in m/s, where nothing limits it."""
EGO_HALF_LENGTH, EGO_HALF_WIDTH = VEHICLE.half_length, VEHICLE.half_width


@uncounted
def ego_to_line(ego: Ego) -> float:
    """Return the metres from an ego's front to its stop line."""
    route = ego.route[0]
    return float(ego.net.legs[route.leg].length - route.s - EGO_HALF_LENGTH)


@uncounted
def gap_to_ego(ego: Ego, car: Any, reach: float) -> tuple[float, float]:
    """Return how far a car can drive before it would touch the ego where that is now, and the ego's speed along it.

    Only the next ``reach`` metres are looked at; FAR if the ego is not in the way there.
    """
    state = ego.state
    dx, dy = state[0] - car.x, state[1] - car.y
    if dx * dx + dy * dy > (reach + 8.0) * (reach + 8.0):
        return FAR, 0.0
    cos, sin = math.cos(state[2]), math.sin(state[2])
    half_width = EGO_HALF_WIDTH + 0.5 * car.width + MARGIN
    s = 0.0
    while s <= reach:
        x, y, ux, uy = point_ahead(ego.net, car.leg, car.gate, car.inside, car.s + s)
        px, py = x - state[0], y - state[1]
        facing = cos * ux + sin * uy
        # A car that comes from the side meets the ego with its flank.
        half_length = EGO_HALF_LENGTH + MARGIN + (1.0 - abs(facing)) * 0.5 * car.width
        if abs(px * cos + py * sin) < half_length and abs(py * cos - px * sin) < half_width:
            return s, max(0.0, state[3] * facing)
        s += STRIDE
    return FAR, 0.0


@uncounted
def gap_to_merging_ego(ego: Ego, car: Any) -> float:
    """Return the gap to an ego that is in the junction and will be in a car's lane before it, metres; else FAR."""
    route = ego.route[0]
    if route.gate < 0 or car.gate < 0 or route.leg == car.leg or not route.inside:
        return FAR
    theirs, ours = ego.net.gates[route.leg, route.gate], ego.net.gates[car.leg, car.gate]
    if theirs.leg != ours.leg:
        return FAR
    left, rest = theirs.inner - route.s, ours.inner - car.s
    if not car.inside:
        rest += ego.net.legs[car.leg].length
    gap = rest - left - EGO_HALF_LENGTH
    return float(gap) if gap > 0.0 else FAR


@uncounted
def ego_crosses(ego: Ego, car: Any) -> bool:
    """Return whether the ego is in the junction ahead of a car, on a way that crosses the car's."""
    route = ego.route[0]
    if route.gate < 0:
        return False
    if not ego.streets.rules[3 * car.leg + car.gate, 3 * route.leg + route.gate] & CROSSES:
        return False
    if route.inside:
        return bool(route.s < ego.net.gates[route.leg, route.gate].inner + EGO_HALF_LENGTH)
    return ego_to_line(ego) < 0.0
