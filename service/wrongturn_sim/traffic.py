"""Who else is in the town: cars and pedestrians, drawn from the trial's seed alone. It needs no SUMO.

Cars stand one to a slot of the lanes and then drive on at random through the junctions' exits; a trip that ends at the
edge of a town (only the small one has such ends) is followed by another that comes in there. Pedestrians walk along
the sidewalks, round their block, since no crossing leads over the street.
"""

import random
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_networks import Town
from wrongturn_networks.lanes import Line
from wrongturn_networks.netfile import shape_of
from wrongturn_protocol import Trial
from wrongturn_sim.errors import TrafficTooDenseError
from wrongturn_sim.route import Pose

CLEARANCE: Final = 15.0
"""No car's front begins nearer to the ego's centre than this, metres."""
PEDESTRIAN_CLEARANCE: Final = 5.0
"""The same of pedestrians."""
DRIVE_LENGTH: Final = 1200.0
"""Every car has so many metres before it: more than it can drive before the time is out."""
WALK_LENGTH: Final = 200.0
"""And every pedestrian so many."""
COLOURS: Final = 256
"""Colour numbers run from 0 to below this."""
_SLOT: Final = 10.0
_FIRST: Final = 6.5
_LAST: Final = 3.0
_JITTER: Final = 1.5
_PACE: Final = 2.0  # metres of sidewalk to a pedestrian


@dataclass(frozen=True)
class Body:
    """A kind of car, in metres."""

    name: str
    length: float
    width: float
    height: float
    share: float
    """Of all cars."""


BODIES: Final = (
    Body("small", 3.7, 1.65, 1.48, 0.3),
    Body("saloon", 4.6, 1.84, 1.44, 0.4),
    Body("tall", 4.5, 1.9, 1.68, 0.2),
    Body("van", 5.5, 2.05, 2.4, 0.1),
)


@dataclass(frozen=True)
class Trip:
    """From a place in a lane along the edges to the end of the last one."""

    lane: str
    at: float
    """Where the front bumper is, as a share of the lane's length."""
    edges: tuple[str, ...]


@dataclass(frozen=True)
class Car:
    """One car and its trips, one after the other."""

    body: Body
    trips: tuple[Trip, ...]
    colour: int


@dataclass(frozen=True)
class Pedestrian:
    """Somebody on foot."""

    edges: tuple[str, ...]
    """Whose sidewalks are walked along, in either direction."""
    at: float
    """Where on the first, as a share of its length in the edge's direction."""
    until: float
    """Where on the last, likewise: 0 or 1."""
    speed: float
    """m/s."""
    height: float
    """Metres."""
    colour: int


@dataclass(frozen=True)
class TrafficPlan:
    """All that share the town with the ego."""

    cars: tuple[Car, ...]
    pedestrians: tuple[Pedestrian, ...]
    ego: tuple[str, ...]
    """The edges by which the others expect the ego to go, as its indicators would tell: its route's."""


def plan_traffic(town: Town, trial: Trial, start: Pose) -> TrafficPlan | None:
    """The other road users of a trial; None where it has none.

    Args:
        town: the trial's.
        trial: its seed and numbers of vehicles and pedestrians count.
        start: of the ego, which is left free.

    Raises:
        TrafficTooDenseError: so many do not find room in the town.
    """
    if not (trial.traffic.vehicles or trial.traffic.pedestrians):
        return None
    approach = town.approach(trial.approach)
    lanes = (approach.lane, approach.exits[trial.route].lane)
    return TrafficPlan(
        _cars(town, trial.traffic.vehicles, start, random.Random(f"vehicles {trial.seed}")),
        _pedestrians(town, trial.traffic.pedestrians, start, random.Random(f"pedestrians {trial.seed}")),
        tuple(town.lanes[lane].edge for lane in lanes),
    )


def _cars(town: Town, count: int, start: Pose, draw: random.Random) -> tuple[Car, ...]:
    entries = sorted(lane.id for lane in town.lanes.values() if lane.start_junction is None)
    cars = []
    # Within a lane the foremost first: SUMO lets nobody in before a car that could not brake in time.
    for name, front in sorted(
        _sample(draw, car_slots(town), count, start, "vehicles", town), key=lambda slot: (slot[0], -slot[1])
    ):
        body = draw.choices(BODIES, [body.share for body in BODIES])[0]
        at = (front + draw.uniform(0.0, _JITTER)) / town.lanes[name].length
        cars.append(Car(body, _trips(town, Trip(name, at, ()), entries, draw), draw.randrange(COLOURS)))
    return tuple(cars)


def _trips(town: Town, first: Trip, entries: list[str], draw: random.Random) -> tuple[Trip, ...]:
    trips = []
    trip, left = first, DRIVE_LENGTH
    while True:
        lane = town.lanes[trip.lane]
        edges = [lane.edge]
        left -= lane.length * (1.0 - trip.at)
        while left > 0.0 and (approach := town.approach_of_lane(lane.id)) is not None:
            lane = town.lanes[draw.choice(list(approach.exits.values())).lane]
            edges.append(lane.edge)
            left -= lane.length
        trips.append(Trip(trip.lane, trip.at, tuple(edges)))
        if left <= 0.0 or not entries:
            return tuple(trips)
        entry = draw.choice(entries)
        trip = Trip(entry, _FIRST / town.lanes[entry].length, ())


@dataclass(frozen=True, eq=False)
class Sidewalks:
    """Where one can walk: an edge's sidewalk has an end at either of two walking areas."""

    lines: dict[str, Line]
    """(N, 2), by edge, in the edge's direction."""
    ends: dict[str, tuple[str, str]]
    """The walking areas at its begin and its end."""
    meeting: dict[str, tuple[str, ...]]
    """The edges whose sidewalks meet at a walking area."""


@lru_cache(maxsize=16)
def sidewalks_of(town: Town) -> Sidewalks:
    """The sidewalks of a town's net, those that join others at both ends."""
    root = ET.parse(town.net_file).getroot()  # noqa: S314 - a file of the town, held by its checksum
    areas = {edge.attrib["id"] for edge in root.iter("edge") if edge.get("function") == "walkingarea"}
    lines = {
        lane.attrib["id"]: shape_of(lane.attrib["shape"])
        for edge in root.iter("edge")
        if edge.get("function") is None
        for lane in edge.iter("lane")
    }
    begins: dict[str, str] = {}
    ends: dict[str, tuple[str, str]] = {}
    lanes: dict[str, str] = {}
    links = [connection.attrib for connection in root.iter("connection")]
    for link in links:
        if link["from"] in areas:
            begins[link["to"]] = link["from"]
    for link in links:
        if link["to"] in areas and link["from"] in begins:
            ends[link["from"]] = (begins[link["from"]], link["to"])
            lanes[link["from"]] = f"{link['from']}_{link['fromLane']}"
    meeting: defaultdict[str, list[str]] = defaultdict(list)
    for edge in sorted(ends):
        for area in ends[edge]:
            meeting[area].append(edge)
    return Sidewalks(
        {edge: lines[lanes[edge]] for edge in ends},
        ends,
        {area: tuple(edges) for area, edges in meeting.items()},
    )


def _pedestrians(town: Town, count: int, start: Pose, draw: random.Random) -> tuple[Pedestrian, ...]:
    if not count:
        return ()
    walks = sidewalks_of(town)
    people = []
    for edge, along in _sample(draw, pedestrian_slots(town), count, start, "pedestrians", town):
        length = _length(walks.lines[edge])
        forward = draw.random() < 0.5
        edges, left = [edge], WALK_LENGTH - (length - along if forward else along)
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
            left -= _length(walks.lines[other])
        speed, height = round(draw.uniform(1.2, 1.6), 2), round(draw.uniform(1.55, 1.9), 2)
        people.append(Pedestrian(tuple(edges), along / length, until, speed, height, draw.randrange(COLOURS)))
    return tuple(people)


@dataclass(frozen=True, eq=False)
class Slots:
    """Where somebody may begin."""

    places: tuple[tuple[str, float], ...]
    """Lane or edge, and metres along it."""
    points: NDArray[np.float64]
    """(n, 2): where that is."""
    clearance: float
    """From the ego's start, metres."""


@lru_cache(maxsize=16)
def car_slots(town: Town) -> Slots:
    """Where front bumpers may be, so that neighbours keep apart whatever their bodies and jitter."""
    lines = {name: lane.centreline for name, lane in town.lanes.items()}
    return _slots(lines, _FIRST, _SLOT, _LAST + _JITTER, CLEARANCE)


@lru_cache(maxsize=16)
def pedestrian_slots(town: Town) -> Slots:
    """Where pedestrians may be."""
    return _slots(sidewalks_of(town).lines, _PACE, _PACE, _PACE, PEDESTRIAN_CLEARANCE)


def _slots(lines: Mapping[str, Line], first: float, pitch: float, last: float, clearance: float) -> Slots:
    places: list[tuple[str, float]] = []
    points = [np.empty((0, 2))]
    for name, line in sorted(lines.items()):
        along = _along(line)
        at = np.arange(first, float(along[-1]) - last, pitch)
        places += [(name, place) for place in at.tolist()]
        points.append(np.column_stack((np.interp(at, along, line[:, 0]), np.interp(at, along, line[:, 1]))))
    return Slots(tuple(places), np.concatenate(points), clearance)


def _sample(
    draw: random.Random, slots: Slots, count: int, start: Pose, field: str, town: Town
) -> list[tuple[str, float]]:
    dx, dy = slots.points[:, 0] - start.x, slots.points[:, 1] - start.y
    free = np.flatnonzero(dx * dx + dy * dy >= slots.clearance**2).tolist()
    if count > len(free):
        raise TrafficTooDenseError(
            f"traffic.{field}: {town.name} has room for {len(free)} beside the car's start and not for {count}; "
            "ask for fewer",
        )
    return [slots.places[k] for k in draw.sample(free, count)]


def _along(line: Line) -> NDArray[np.float64]:
    """Metres from the begin of a line to each of its points."""
    steps = np.diff(line, axis=0)
    return np.concatenate(([0.0], np.cumsum(np.sqrt(steps[:, 0] ** 2 + steps[:, 1] ** 2))))


def _length(line: Line) -> float:
    return float(_along(line)[-1])
