"""The start of an ego's traffic: cars and pedestrians at random places, apart from each other and from the ego."""

import math
from typing import Any

from wrongturn_judge.compiling import uncounted
from wrongturn_sim.fleet.drivers import BRAKING, GAP, REACTION, STOP, choose_gate, leader_of, safe_speed
from wrongturn_sim.fleet.ego_ahead import EGO_HALF_LENGTH, FAR, gap_to_ego
from wrongturn_sim.fleet.others import Ego, draw, place_car, place_walker
from wrongturn_sim.traffic import plan, slots

CLEARANCE, PEDESTRIAN_CLEARANCE, JITTER = slots.CLEARANCE, slots.PEDESTRIAN_CLEARANCE, slots.JITTER
COLOURS = plan.COLOURS
_TRIES = 200
_NEAR_LEADER = 12.0  # no slot this near to the car that was put ahead of the ego, metres
_LAST = 3.0  # metres between that car and the stop line
_ASIDE = 0.6  # pedestrians walk this far to either side of the pavement's middle, metres


@uncounted
def free_slot(ego: Ego, taken: int) -> int:
    """Return a random slot for a car, away from the ego and from those that are taken."""
    # An ego at speed gets more room: it must be able to stop.
    state, starts = ego.state, ego.streets.slots
    clear = CLEARANCE + state[3] * state[3] / 8.0
    slot = 0
    for _ in range(_TRIES):
        slot = int(draw(ego) * len(starts))
        dx, dy = starts[slot, 2] - state[0], starts[slot, 3] - state[1]
        free = dx * dx + dy * dy >= clear * clear
        for k in range(taken):
            car = ego.cars[k]
            if car.goes == slot or (
                car.goes < 0 and car.leg == starts[slot, 0] and abs(car.s - starts[slot, 1]) < _NEAR_LEADER
            ):
                free = False
                break
        if free:
            return slot
    return slot


@uncounted
def lead(ego: Ego, car: Any) -> bool:
    """Put a car shortly ahead of the ego, in its lane; return False where there is no room."""
    route, v = ego.route[0], ego.state[3]
    begin = route.s + EGO_HALF_LENGTH + 6.0 + v * v / 8.0 + car.length
    end = min(ego.net.legs[route.leg].length - _LAST, begin + 20.0)
    if route.inside or end < begin:
        return False
    car.leg, car.goes = route.leg, -1
    car.s = begin + (end - begin) * draw(ego)
    return True


@uncounted
def settle_car(ego: Ego, k: int) -> None:
    """Draw a car and its place, which ``goes`` marks by the slot's number until all have one; its speed comes later."""
    car, bodies, traffic = ego.cars[k], ego.streets.bodies, ego.traffic[0]
    car.stays_for = -1
    share, body = draw(ego), 0
    while body < len(bodies) - 1 and bodies[body, 3] <= share:
        body += 1
    car.length, car.width, car.height = bodies[body, 0], bodies[body, 1], bodies[body, 2]
    car.colour = math.floor(draw(ego) * COLOURS)
    # The sum of three is nearly normal: mean 1, deviation 0.1.
    car.likes = 0.7 + 0.2 * (draw(ego) + draw(ego) + draw(ego))
    if draw(ego) < traffic.hesitant:
        car.likes = 0.3 + 0.4 * draw(ego)
        car.until, car.stands = 20.0 * draw(ego), 1.0 + 5.0 * draw(ego)
    car.here = 1
    leads = k == 0 and draw(ego) < traffic.leaders
    if leads and lead(ego, car):
        return
    slot = free_slot(ego, k)
    car.leg, car.goes = int(ego.streets.slots[slot, 0]), slot
    car.s = ego.streets.slots[slot, 1] + JITTER * draw(ego)


@uncounted
def settle_walker(ego: Ego, k: int) -> None:
    """Draw a pedestrian."""
    walker, doors = ego.walkers[k], ego.streets.doors
    door = 0
    for _ in range(_TRIES):
        door = int(draw(ego) * len(doors))
        dx, dy = doors[door, 2] - ego.state[0], doors[door, 3] - ego.state[1]
        if dx * dx + dy * dy >= PEDESTRIAN_CLEARANCE * PEDESTRIAN_CLEARANCE:
            break
    walker.walk = int(doors[door, 0])
    walker.s = doors[door, 1]
    speed = math.floor((1.2 + 0.4 * draw(ego)) * 100.0) / 100.0
    walker.v = speed if draw(ego) < 0.5 else -speed
    walker.aside = _ASIDE * (2.0 * draw(ego) - 1.0)
    walker.height = math.floor((1.55 + 0.35 * draw(ego)) * 100.0) / 100.0
    walker.colour = math.floor(draw(ego) * COLOURS)
    place_walker(ego.streets, walker)


@uncounted
def settle(ego: Ego) -> None:
    """Place an ego's traffic. Its numbers, shares and random state are set; all else is 0."""
    count = ego.traffic[0].vehicles
    for k in range(count):
        settle_car(ego, k)
    for k in range(count):
        ego.cars[k].goes = 0
        choose_gate(ego, ego.cars[k])
        place_car(ego.net, ego.cars[k])
    for k in range(count):
        car = ego.cars[k]
        # As if everything ahead stood still: so all can stop in time, whatever comes.
        gap, _ = leader_of(ego, k)
        room = gap - GAP
        gap, _ = gap_to_ego(ego, car, 40.0)
        room = min(room, gap - GAP)
        if car.gate >= 0:
            room = min(room, ego.net.legs[car.leg].length - car.s - STOP)
        car.v = min(car.likes * ego.streets.limits[car.leg], safe_speed(min(room, FAR), 0.0, BRAKING, REACTION))
    for k in range(ego.traffic[0].pedestrians):
        settle_walker(ego, k)
