"""The traffic plan: cars and pedestrians, drawn from the trial's seed alone. It needs no SUMO.

Each car starts in a slot of a lane and takes random exits at the junctions. Where a trip ends at the edge of the town
(only the small town has such ends), the car begins another trip at a random entry. Pedestrians walk along the
sidewalks round their block, because no crossing leads over the street.
"""

import random
from dataclasses import dataclass
from typing import Final

from wrongturn_networks import Town
from wrongturn_protocol import Trial
from wrongturn_sim.errors import TrafficTooDenseError
from wrongturn_sim.polyline import Polyline
from wrongturn_sim.route import Navigator, Pose
from wrongturn_sim.traffic.slots import FIRST, JITTER, Slots, car_slots, pedestrian_slots, sidewalks_of

DRIVE_LENGTH: Final = 1200.0
"""Length of a car's trips in all, metres: more than it can drive within the time limit."""
WALK_LENGTH: Final = 200.0
"""Length of a pedestrian's walk, metres."""
DRIVE_PACE: Final = 15.0
WALK_PACE: Final = 1.7
"""A journey takes longer: its trips and walks have this many metres for each second of its time limit."""
EGO_LENGTH: Final = 2000.0
"""Metres of the ego's route that other drivers know on a journey: more than any goal is away."""
COLOURS: Final = 256
"""Colours are numbered from 0 to below this."""


@dataclass(frozen=True)
class Body:
    """A kind of car body, metres."""

    name: str
    length: float
    width: float
    height: float
    share: float
    """Share of all cars."""


BODIES: Final = (
    Body("small", 3.7, 1.65, 1.48, 0.3),
    Body("saloon", 4.6, 1.84, 1.44, 0.4),
    Body("tall", 4.5, 1.9, 1.68, 0.2),
    Body("van", 5.5, 2.05, 2.4, 0.1),
)


@dataclass(frozen=True)
class Trip:
    """A drive from a place in a lane along edges, to the end of the last one."""

    lane: str
    at: float
    """Place of the front bumper, as a share of the lane's length."""
    edges: tuple[str, ...]


@dataclass(frozen=True)
class TrafficCar:
    """A car and its trips, one after the other."""

    body: Body
    trips: tuple[Trip, ...]
    colour: int


@dataclass(frozen=True)
class Pedestrian:
    """A pedestrian."""

    edges: tuple[str, ...]
    """Edges along whose sidewalks the pedestrian walks, in either direction."""
    at: float
    """Start on the first sidewalk, as a share of its length in the edge's direction."""
    until: float
    """End on the last sidewalk, likewise: 0 or 1."""
    speed: float
    """Speed, m/s."""
    height: float
    """Height, metres."""
    colour: int


@dataclass(frozen=True)
class TrafficPlan:
    """All road users that share the town with the ego."""

    cars: tuple[TrafficCar, ...]
    pedestrians: tuple[Pedestrian, ...]
    ego: tuple[str, ...]
    """Edges of the ego's route. The other drivers know them, as if the ego used its indicators."""
    closed: tuple[str, ...] = ()
    """Lanes that boards close, where no car may drive."""


def plan_traffic(town: Town, trial: Trial, start: Pose) -> TrafficPlan | None:
    """Draw the other road users of a trial, away from the ego's start; None for none. Raises TrafficTooDenseError."""
    if not (trial.traffic.vehicles or trial.traffic.pedestrians):
        return None
    time_limit = 0.0
    if trial.journey is None:
        approach = town.approach(trial.approach)
        lanes: tuple[str, ...] = (approach.lane, approach.exits[trial.route].lane)
    else:
        time_limit = trial.journey.time_limit
        lanes = Navigator(town, trial).lanes_ahead(EGO_LENGTH)
    drive, walk = max(DRIVE_LENGTH, DRIVE_PACE * time_limit), max(WALK_LENGTH, WALK_PACE * time_limit)
    return TrafficPlan(
        _cars(town, trial.traffic.vehicles, start, drive, random.Random(f"vehicles {trial.seed}")),
        _pedestrians(town, trial.traffic.pedestrians, start, walk, random.Random(f"pedestrians {trial.seed}")),
        tuple(town.lanes[lane].edge for lane in lanes),
        town.closed,
    )


def _cars(town: Town, count: int, start: Pose, metres: float, draw: random.Random) -> tuple[TrafficCar, ...]:
    entries = sorted(
        lane.id for lane in town.lanes.values() if lane.start_junction is None and lane.id not in town.closed
    )
    cars = []
    # Within a lane the foremost car first: SUMO inserts no car in front of one that could not brake in time.
    for name, front in sorted(
        _sample(draw, car_slots(town), count, start, "vehicles", town), key=lambda slot: (slot[0], -slot[1])
    ):
        body = draw.choices(BODIES, [body.share for body in BODIES])[0]
        at = (front + draw.uniform(0.0, JITTER)) / town.lanes[name].length
        cars.append(TrafficCar(body, _trips(town, Trip(name, at, ()), entries, metres, draw), draw.randrange(COLOURS)))
    return tuple(cars)


def _trips(town: Town, first: Trip, entries: list[str], metres: float, draw: random.Random) -> tuple[Trip, ...]:
    trips = []
    trip, left = first, metres
    while True:
        lane = town.lanes[trip.lane]
        edges = [lane.edge]
        left -= lane.length * (1.0 - trip.at)
        while left > 0.0 and (approach := town.approach_of_lane(lane.id)) is not None:
            open_ = [leaving.lane for leaving in approach.exits.values() if leaving.lane not in town.closed]
            lane = town.lanes[draw.choice(open_)]
            edges.append(lane.edge)
            left -= lane.length
        trips.append(Trip(trip.lane, trip.at, tuple(edges)))
        if left <= 0.0 or not entries:
            return tuple(trips)
        entry = draw.choice(entries)
        trip = Trip(entry, FIRST / town.lanes[entry].length, ())


def _pedestrians(town: Town, count: int, start: Pose, metres: float, draw: random.Random) -> tuple[Pedestrian, ...]:
    if not count:
        return ()
    walks = sidewalks_of(town)
    people = []
    for edge, along in _sample(draw, pedestrian_slots(town), count, start, "pedestrians", town):
        length = Polyline(walks.lines[edge]).length
        forward = draw.random() < 0.5
        edges, left = [edge], metres - (length - along if forward else along)
        area = walks.ends[edge][forward]
        until = float(forward)
        while left > 0.0:
            others = [other for other in walks.meeting[area] if other != edges[-1]]
            if not others:
                break
            other = draw.choice(others)
            begin, end = walks.ends[other]
            area, until = (end, 1.0) if begin == area else (begin, 0.0)
            edges.append(other)
            left -= Polyline(walks.lines[other]).length
        speed, height = round(draw.uniform(1.2, 1.6), 2), round(draw.uniform(1.55, 1.9), 2)
        people.append(Pedestrian(tuple(edges), along / length, until, speed, height, draw.randrange(COLOURS)))
    return tuple(people)


def _sample(
    draw: random.Random, slots: Slots, count: int, start: Pose, field: str, town: Town
) -> list[tuple[str, float]]:
    free = [k for k in slots.free(start.x, start.y) if slots.places[k][0] not in town.closed]
    if count > len(free):
        raise TrafficTooDenseError(
            f"traffic.{field}: {town.name} has room for {len(free)} besides the car at its start, not for {count}; "
            "ask for fewer"
        )
    return [slots.places[k] for k in draw.sample(free, count)]
