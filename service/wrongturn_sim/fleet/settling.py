"""The start of an ego's traffic: cars and pedestrians at random places, apart from each other and from the ego."""

import math

from wrongturn_judge.compiling import uncounted
from wrongturn_judge.kernels import Array
from wrongturn_sim import guide
from wrongturn_sim.fleet.drivers import BRAKING, GAP, REACTION, STOP, choose_gate, leader_of, safe_speed
from wrongturn_sim.fleet.ego_ahead import EGO_HALF_LENGTH, FAR, gap_to_ego
from wrongturn_sim.fleet.others import (
    COLOUR,
    FOR,
    GATE,
    GOES,
    HEIGHT,
    HERE,
    HESITANT,
    INSIDE,
    LEADS,
    LEG,
    LENGTH,
    LIKES,
    PEDESTRIANS,
    STANDS,
    UNTIL,
    VEHICLES,
    W_ASIDE,
    W_COLOUR,
    W_HEIGHT,
    W_S,
    W_V,
    WAITED,
    WIDTH,
    A,
    Others,
    S,
    V,
    draw,
    place_car,
    place_walker,
)
from wrongturn_sim.fleet.streets import Streets
from wrongturn_sim.traffic import plan, slots

CLEARANCE, PEDESTRIAN_CLEARANCE, JITTER = slots.CLEARANCE, slots.PEDESTRIAN_CLEARANCE, slots.JITTER
COLOURS = plan.COLOURS
_TRIES = 200
_NEAR_LEADER = 12.0  # no slot this near to the car that was put ahead of the ego, metres
_LAST = 3.0  # metres between that car and the stop line
_ASIDE = 0.6  # pedestrians walk this far to either side of the pavement's middle, metres


@uncounted
def free_slot(streets: Streets, others: Others, i: int, taken: int, state: Array) -> int:
    """Return a random slot for a car, away from the ego and from those that are taken."""
    # An ego at speed gets more room: it must be able to stop.
    clear = CLEARANCE + state[3] * state[3] / 8.0
    slot = 0
    for _ in range(_TRIES):
        slot = int(draw(others, i) * len(streets.slots))
        dx, dy = streets.slots[slot, 2] - state[0], streets.slots[slot, 3] - state[1]
        free = dx * dx + dy * dy >= clear * clear
        for k in range(taken):
            way = others.ways[i, k]
            if way[GOES] == slot or (
                way[GOES] < 0
                and way[LEG] == streets.slots[slot, 0]
                and abs(others.cars[i, k, S] - streets.slots[slot, 1]) < _NEAR_LEADER
            ):
                free = False
                break
        if free:
            return slot
    return slot


@uncounted
def lead(lengths: Array, others: Others, i: int, k: int, progress: Array, places: Array, state: Array) -> bool:
    """Put a car shortly ahead of the ego, in its lane; return False where there is no room."""
    car, way = others.cars[i, k], others.ways[i, k]
    leg = progress[guide.P_LEG]
    begin = places[guide.P_S] + EGO_HALF_LENGTH + 6.0 + state[3] * state[3] / 8.0 + car[LENGTH]
    end = min(lengths[leg, guide.F_LENGTH] - _LAST, begin + 20.0)
    if progress[guide.P_INSIDE] or end < begin:
        return False
    way[LEG], way[GOES] = leg, -1
    car[S] = begin + (end - begin) * draw(others, i)
    return True


@uncounted
def settle_car(
    streets: Streets, lengths: Array, others: Others, i: int, k: int, progress: Array, places: Array, state: Array
) -> None:
    """Draw a car and its place; its speed comes later."""
    car, way = others.cars[i, k], others.ways[i, k]
    car[:] = 0.0
    way[:] = 0
    way[FOR] = -1
    share, body = draw(others, i), 0
    while body < len(streets.bodies) - 1 and streets.bodies[body, 3] <= share:
        body += 1
    car[LENGTH], car[WIDTH], car[HEIGHT] = streets.bodies[body, 0], streets.bodies[body, 1], streets.bodies[body, 2]
    car[COLOUR] = math.floor(draw(others, i) * COLOURS)
    # The sum of three is nearly normal: mean 1, deviation 0.1.
    car[LIKES] = 0.7 + 0.2 * (draw(others, i) + draw(others, i) + draw(others, i))
    if draw(others, i) < others.habits[i, HESITANT]:
        car[LIKES] = 0.3 + 0.4 * draw(others, i)
        car[UNTIL], car[STANDS] = 20.0 * draw(others, i), 1.0 + 5.0 * draw(others, i)
    way[HERE] = 1
    leads = k == 0 and draw(others, i) < others.habits[i, LEADS]
    if leads and lead(lengths, others, i, k, progress, places, state):
        return
    slot = free_slot(streets, others, i, k, state)
    way[LEG], way[GOES] = int(streets.slots[slot, 0]), slot
    car[S] = streets.slots[slot, 1] + JITTER * draw(others, i)


@uncounted
def settle_walker(streets: Streets, others: Others, i: int, k: int, state: Array) -> None:
    """Draw a pedestrian."""
    walker = others.walkers[i, k]
    door = 0
    for _ in range(_TRIES):
        door = int(draw(others, i) * len(streets.doors))
        dx, dy = streets.doors[door, 2] - state[0], streets.doors[door, 3] - state[1]
        if dx * dx + dy * dy >= PEDESTRIAN_CLEARANCE * PEDESTRIAN_CLEARANCE:
            break
    others.walks[i, k] = int(streets.doors[door, 0])
    walker[W_S] = streets.doors[door, 1]
    speed = math.floor((1.2 + 0.4 * draw(others, i)) * 100.0) / 100.0
    walker[W_V] = speed if draw(others, i) < 0.5 else -speed
    walker[W_ASIDE] = _ASIDE * (2.0 * draw(others, i) - 1.0)
    walker[W_HEIGHT] = math.floor((1.55 + 0.35 * draw(others, i)) * 100.0) / 100.0
    walker[W_COLOUR] = math.floor(draw(others, i) * COLOURS)
    place_walker(streets, walker, others.walks[i, k])


@uncounted
def settle(
    streets: Streets, points: Array, along: Array, legs: Array, lengths: Array, others: Others, i: int,
    progress: Array, places: Array, state: Array,
) -> None:  # fmt: skip
    """Place an ego's traffic; the numbers, habits and random state are set."""
    count = others.counts[i, VEHICLES]
    for k in range(count):
        settle_car(streets, lengths, others, i, k, progress, places, state)
    for k in range(count):
        others.ways[i, k, GOES] = others.ways[i, k, INSIDE] = 0
        choose_gate(legs, others, i, k)
        place_car(points, along, legs, lengths, others.cars[i, k], others.ways[i, k])
    for k in range(count):
        car, way = others.cars[i, k], others.ways[i, k]
        # As if everything ahead stood still: so all can stop in time, whatever comes.
        gap, _ = leader_of(legs, lengths, others, i, k)
        room = gap - GAP
        gap, _ = gap_to_ego(points, along, legs, lengths, others, i, k, 40.0, state)
        room = min(room, gap - GAP)
        if way[GATE] >= 0:
            room = min(room, lengths[way[LEG], guide.F_LENGTH] - car[S] - STOP)
        car[V] = min(car[LIKES] * streets.limits[way[LEG]], safe_speed(min(room, FAR), 0.0, BRAKING, REACTION))
        car[A] = car[WAITED] = 0.0
    for k in range(others.counts[i, PEDESTRIANS]):
        settle_walker(streets, others, i, k, state)
