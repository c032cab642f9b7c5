"""The other road users of a running episode: inserted into SUMO, and seen from the ego."""

import math
from types import ModuleType
from typing import Final, NamedTuple

from wrongturn_judge.trajectory import Appearance, RoadUser
from wrongturn_sim.traffic.plan import TrafficPlan, Trip

VISIBLE_RANGE: Final = 80.0
"""Road users within this distance are visible, metres between the bodies' centres."""
VEHICLE_KIND: Final = 0
PEDESTRIAN_KIND: Final = 1
PEDESTRIAN_SIZE: Final = 0.5
"""Length and width of a pedestrian, metres."""
OTHERS: Final = 8
"""Numbers of each road user for pictures: x, y, yaw, length, width, height, kind, colour."""
_END: Final = 0.5  # a walk ends this far before the sidewalk's end, metres
_RADIANS: Final = math.pi / 180.0
_QUARTER: Final = math.pi / 2
_TURN: Final = 2.0 * math.pi
_NEAR: Final = (VISIBLE_RANGE + 5.0) ** 2
_SQUARE: Final = VISIBLE_RANGE**2


Sighting = tuple[float, int, RoadUser, Appearance]
"""A visible road user: square of its distance, number, what an observation shows of it, looks."""


class _Body(NamedTuple):
    """What stays the same about a road user."""

    number: int
    length: float
    width: float
    appearance: Appearance


class Crowd:
    """The other road users of one episode, in SUMO, which has newly loaded the town's net."""

    __slots__ = ("_bodies", "_later", "_plan", "_sumo")

    def __init__(self, sumo: ModuleType, plan: TrafficPlan) -> None:
        self._sumo = sumo
        self._plan = plan
        self._bodies: dict[str, _Body] = {}
        self._later: dict[str, list[Trip]] = {}

    def enter(self) -> tuple[Appearance, ...]:
        """Insert all road users, which appear with SUMO's next steps; return their looks, by their numbers."""
        sumo, plan = self._sumo, self._plan
        for body in sorted({car.body for car in plan.cars}, key=lambda body: body.name):
            kind = f"wrongturn-{body.name}"
            sumo.vehicletype.copy("DEFAULT_VEHTYPE", kind)
            sumo.vehicletype.setLength(kind, body.length)
            sumo.vehicletype.setWidth(kind, body.width)
            sumo.vehicletype.setHeight(kind, body.height)
        for k, car in enumerate(plan.cars):
            name, body = f"v{k}", car.body
            looks = Appearance(body.height, VEHICLE_KIND, car.colour)
            self._bodies[name] = _Body(k, body.length, body.width, looks)
            self._later[name] = list(car.trips[::-1])
            self._depart(name)
        for k, person in enumerate(plan.pedestrians):
            name = f"p{k}"
            number = len(plan.cars) + k
            looks = Appearance(person.height, PEDESTRIAN_KIND, person.colour)
            self._bodies[name] = _Body(number, PEDESTRIAN_SIZE, PEDESTRIAN_SIZE, looks)
            first, last = (sumo.lane.getLength(f"{person.edges[i]}_0") for i in (0, -1))
            sumo.person.add(name, person.edges[0], person.at * first)
            goal = min(max(person.until * last, _END), last - _END)
            sumo.person.appendWalkingStage(name, person.edges, goal, speed=person.speed)
        return tuple(body.appearance for body in self._bodies.values())

    def _depart(self, name: str) -> None:
        """Send a car on its next trip, if it has one left."""
        if not self._later[name]:
            return
        sumo = self._sumo
        trip = self._later[name].pop()
        route = f"{name} {len(self._later[name])}"
        sumo.route.add(route, trip.edges)
        lane = trip.lane.removeprefix(f"{trip.edges[0]}_")
        at = trip.at * sumo.lane.getLength(trip.lane)
        kind = f"wrongturn-{self._plan.cars[self._bodies[name].number].body.name}"
        sumo.vehicle.add(name, route, kind, depart="now", departLane=lane, departPos=repr(at), departSpeed="max")

    def update(self, x: float, y: float) -> list[Sighting]:
        """Start the next trip of cars that finished one, and return the road users near a point, nearest first."""
        sumo, floor, remainder = self._sumo, math.floor, math.remainder
        seen: list[Sighting] = []
        for name in sumo.simulation.getArrivedIDList():
            if name in self._later:
                self._depart(name)
        for domain in (sumo.vehicle, sumo.person) if self._plan.pedestrians else (sumo.vehicle,):
            position = domain.getPosition
            for name in domain.getIDList():
                px, py = position(name)
                dx, dy = px - x, py - y
                if dx * dx + dy * dy > _NEAR or (body := self._bodies.get(name)) is None:
                    continue
                # SUMO's angle runs clockwise from north; a car's position is the front bumper's centre.
                # Rounding towards 0 keeps the yaw within pi.
                yaw = int(remainder(_QUARTER - domain.getAngle(name) * _RADIANS, _TURN) * 1e4) / 1e4
                if body.appearance.kind == VEHICLE_KIND:
                    px -= body.length / 2 * math.cos(yaw)
                    py -= body.length / 2 * math.sin(yaw)
                # Millimetres keep the record short; round() would take half of the time of this function.
                px, py = floor(px * 1e3 + 0.5) / 1e3, floor(py * 1e3 + 0.5) / 1e3
                dx, dy = px - x, py - y
                square = dx * dx + dy * dy
                if square <= _SQUARE:
                    user = (px, py, yaw, body.length, body.width, floor(domain.getSpeed(name) * 1e3 + 0.5) / 1e3)
                    seen.append((square, body.number, user, body.appearance))
        seen.sort()
        return seen

    def waiting(self) -> int:
        """Return the number of road users that SUMO has not inserted yet."""
        here: int = self._sumo.vehicle.getIDCount() + self._sumo.person.getIDCount() - 1
        return len(self._bodies) - here
