"""The ego in the way of a fleet's car: how far away it is, and whether it is in the junction ahead."""

import math

from wrongturn_judge.compiling import uncounted
from wrongturn_judge.kernels import Array
from wrongturn_protocol.vehicle import VEHICLE
from wrongturn_sim import guide
from wrongturn_sim.fleet.others import GATE, INSIDE, LEG, WIDTH, Others, S, X, Y, point_ahead
from wrongturn_sim.fleet.right_of_way import CROSSES
from wrongturn_sim.fleet.streets import Streets

MARGIN = 0.3
"""Drivers brake for an ego whose body is this near to their own car's way, metres."""
STRIDE = 1.5
"""Distance between the points of its way that a driver checks for the ego, metres."""
FAR = 1e9
"""Stands for a gap, in metres, or for a speed, in m/s, where nothing limits it."""
EGO_HALF_LENGTH, EGO_HALF_WIDTH = VEHICLE.half_length, VEHICLE.half_width


@uncounted
def ego_to_line(lengths: Array, progress: Array, places: Array) -> float:
    """Return the metres from an ego's front to its stop line."""
    return float(lengths[progress[guide.P_LEG], guide.F_LENGTH] - places[guide.P_S] - EGO_HALF_LENGTH)


@uncounted
def gap_to_ego(
    points: Array, along: Array, legs: Array, lengths: Array, others: Others, i: int, k: int, reach: float, state: Array
) -> tuple[float, float]:
    """Return how far a car can drive before it would touch the ego where that is now, and the ego's speed along it.

    Only the next ``reach`` metres are looked at; FAR if the ego is not in the way there.
    """
    car, way = others.cars[i, k], others.ways[i, k]
    dx, dy = state[0] - car[X], state[1] - car[Y]
    if dx * dx + dy * dy > (reach + 8.0) * (reach + 8.0):
        return FAR, 0.0
    cos, sin = math.cos(state[2]), math.sin(state[2])
    half_width = EGO_HALF_WIDTH + 0.5 * car[WIDTH] + MARGIN
    s = 0.0
    while s <= reach:
        x, y, ux, uy = point_ahead(points, along, legs, lengths, way[LEG], way[GATE], way[INSIDE], car[S] + s)
        px, py = x - state[0], y - state[1]
        facing = cos * ux + sin * uy
        # A car that comes from the side meets the ego with its flank.
        half_length = EGO_HALF_LENGTH + MARGIN + (1.0 - abs(facing)) * 0.5 * car[WIDTH]
        if abs(px * cos + py * sin) < half_length and abs(py * cos - px * sin) < half_width:
            return s, max(0.0, state[3] * facing)
        s += STRIDE
    return FAR, 0.0


@uncounted
def gap_to_merging_ego(
    legs: Array, lengths: Array, others: Others, i: int, k: int, progress: Array, places: Array
) -> float:  # fmt: skip
    """Return the gap to an ego that is in the junction and will be in a car's lane before it, metres; else FAR."""
    car, way = others.cars[i, k], others.ways[i, k]
    leg, gate = progress[guide.P_LEG], progress[guide.P_GATE]
    if gate < 0 or way[GATE] < 0 or leg == way[LEG] or not progress[guide.P_INSIDE]:
        return FAR
    at, ours = guide.L_GATE + guide.GATE_INTS * gate, guide.L_GATE + guide.GATE_INTS * way[GATE]
    if legs[leg, at + guide.G_LEG] != legs[way[LEG], ours + guide.G_LEG]:
        return FAR
    left = lengths[leg, guide.F_GATE + guide.GATE_FLOATS * gate + guide.G_INNER] - places[guide.P_S]
    rest = lengths[way[LEG], guide.F_GATE + guide.GATE_FLOATS * way[GATE] + guide.G_INNER] - car[S]
    if not way[INSIDE]:
        rest += lengths[way[LEG], guide.F_LENGTH]
    gap = rest - left - EGO_HALF_LENGTH
    return float(gap) if gap > 0.0 else FAR


@uncounted
def ego_crosses(streets: Streets, lengths: Array, way: Array, progress: Array, places: Array) -> bool:
    """Return whether the ego is in the junction ahead of a car, on a way that crosses the car's."""
    leg, gate = progress[guide.P_LEG], progress[guide.P_GATE]
    if gate < 0 or not streets.rules[3 * way[LEG] + way[GATE], 3 * leg + gate] & CROSSES:
        return False
    if progress[guide.P_INSIDE]:
        inner = lengths[leg, guide.F_GATE + guide.GATE_FLOATS * gate + guide.G_INNER]
        return bool(places[guide.P_S] < inner + EGO_HALF_LENGTH)
    return ego_to_line(lengths, progress, places) < 0.0
