"""What a fleet's traffic needs to know of a town: right of way, limits, pavements, and places to start from.

A *gate* is one way through a junction: an approach and one of its exits. It has the number ``3 * leg + exit``.
"""

import xml.etree.ElementTree as ET
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wrongturn_judge.kernels import Array
from wrongturn_networks import Town
from wrongturn_networks.per_net import once_per_net
from wrongturn_sim.polyline import measure
from wrongturn_sim.roads import roads_of
from wrongturn_sim.traffic.plan import BODIES
from wrongturn_sim.traffic.slots import Sidewalks, car_slots, pedestrian_slots, sidewalks_of

CROSSES, YIELDS = 1, 2
"""Bits of a rule: the two ways cross or merge; the first one must give way to the second."""
_SPEED: Final = 13.89  # SUMO's usual limit in towns, m/s
MOST: Final = 0.5
"""Greatest share of a town's places to start from that traffic may take, so that free ones are found by trying."""


class Streets(NamedTuple):
    """Arrays that the traffic of all egos shares."""

    rules: Array
    """(gates, gates) uint8: bits of the rule between any two gates."""
    minor: Array
    """(gates,) bool: whether a car that takes this gate has to give way to anybody."""
    speeds: Array
    """(gates,), speed limit in the junction, m/s."""
    limits: Array
    """(legs,), speed limit of each lane, m/s."""
    slots: Array
    """(S, 4): places for front bumpers: leg, metres along it, x, y."""
    entries: Array
    """(E,) int64: legs that begin at the edge of the town."""
    bodies: Array
    """(B, 4): length, width, height, and share of all cars that have this body or one above it."""
    paths: Array
    """(M, 2): points of the pavements round each block."""
    along: Array
    """(M,): distances along each of them."""
    walks: Array
    """(W, 3) int64: first and end index of each pavement's points; whether it leads back to its start."""
    doors: Array
    """(D, 4): places for pedestrians: pavement, metres along it, x, y."""


@once_per_net(16)
def rules_of(town: Town) -> tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.float64]]:
    """Return the rules of a town's junctions, as SUMO's network states them.

    Returns:
        The rules between any two gates (G, G); the speed limit of each gate (G,) and of each leg (legs,), m/s.
    """
    root = ET.parse(town.net_file).getroot()  # noqa: S314 - a file of the town, whose checksum was compared
    limits = {lane.attrib["id"]: float(lane.get("speed", _SPEED)) for lane in root.iter("lane")}
    roads = roads_of(town)
    gates: dict[str, int] = {}
    speeds = np.full(3 * len(roads.lanes), _SPEED)
    for leg, approach in enumerate(roads.approaches):
        for k, exit_ in enumerate(approach.exits.values() if approach is not None else ()):
            gates.update(dict.fromkeys(exit_.internal_lanes, 3 * leg + k))
            speeds[3 * leg + k] = min(limits[lane] for lane in exit_.internal_lanes)
    rules = np.zeros((len(speeds), len(speeds)), np.uint8)
    for junction in root.iter("junction"):
        numbers = [gates.get(lane) for lane in junction.get("intLanes", "").split()]
        for request in junction.iter("request"):
            ours = numbers[int(request.attrib["index"])]
            for bit, name in ((CROSSES, "foes"), (YIELDS, "response")):
                # The last character is that of the first link.
                for other, flag in zip(numbers, reversed(request.attrib[name]), strict=False):
                    if flag == "1" and ours is not None and other is not None:
                        rules[ours, other] |= bit
    rules |= rules.T & CROSSES
    return rules, speeds, np.array([limits.get(name, _SPEED) for name in roads.names])


@once_per_net(16)
def streets_of(town: Town) -> Streets:
    """Return the streets of a town; they are made once."""
    roads = roads_of(town)
    rules, speeds, limits = rules_of(town)
    cars = car_slots(town)
    slots = [(roads.legs[lane], at, x, y) for (lane, at), (x, y) in zip(cars.places, cars.points.tolist(), strict=True)]
    entries = [roads.legs[lane.id] for lane in town.lanes.values() if lane.start_junction is None]
    shares = np.cumsum([body.share for body in BODIES])
    bodies = [(body.length, body.width, body.height, share) for body, share in zip(BODIES, shares, strict=True)]
    lines, places = _pavements(sidewalks_of(town))
    ends = np.cumsum([0, *(len(line) for line, _ in lines)])
    people = pedestrian_slots(town)
    doors = []
    for (edge, at), (x, y) in zip(people.places, people.points.tolist(), strict=True):
        pavement, begin, length = places[edge]
        doors.append((pavement, begin + at if length > 0.0 else begin - at, x, y))
    return Streets(
        rules=rules,
        minor=np.asarray(((rules & YIELDS) > 0).any(axis=1)),
        speeds=speeds,
        limits=limits,
        slots=np.array(slots, np.float64).reshape(-1, 4),
        entries=np.array(entries, np.int64),
        bodies=np.array(bodies),
        paths=np.concatenate([np.empty((0, 2)), *(line for line, _ in lines)]),
        along=np.concatenate([np.empty(0), *(measure(line) for line, _ in lines)]),
        walks=np.array(
            [(a, b, closed) for a, b, (_, closed) in zip(ends[:-1], ends[1:], lines, strict=True)], np.int64
        ).reshape(-1, 3),
        doors=np.array(doors, np.float64).reshape(-1, 4),
    )


_Place = tuple[int, float, float]
"""Pavement of an edge; where on it the edge's sidewalk begins; 1 or -1 as the pavement follows it or not."""


def _pavements(walks: Sidewalks) -> tuple[list[tuple[NDArray[np.float64], bool]], dict[str, _Place]]:
    """Join sidewalks that meet into pavements; return each one's points and whether it is a ring, and the places."""
    lines: list[tuple[NDArray[np.float64], bool]] = []
    places: dict[str, _Place] = {}
    left = dict.fromkeys(sorted(walks.lines))
    while left:
        chain = _chain(walks, left)
        points = [walks.lines[edge] if forward else walks.lines[edge][::-1] for edge, forward in chain]
        first, last = (
            walks.ends[edge][forward is end] for (edge, forward), end in ((chain[0], False), (chain[-1], True))
        )
        closed = first == last and len(chain) > 1
        line = np.concatenate([*points, points[0][:1]] if closed else points)
        along, at = measure(line), 0
        for (edge, forward), part in zip(chain, points, strict=True):
            begin, end = float(along[at]), float(along[at + len(part) - 1])
            places[edge] = (len(lines), begin, 1.0) if forward else (len(lines), end, -1.0)
            at += len(part)
        lines.append((line, closed))
    return lines, places


def _chain(walks: Sidewalks, left: dict[str, None]) -> list[tuple[str, bool]]:
    """Take sidewalks that lead into each other out of ``left``; return them with their directions."""
    edge = next(iter(left))
    del left[edge]
    chain = [(edge, True)]
    for forwards in (True, False):
        while True:
            edge, forward = chain[-1] if forwards else chain[0]
            area = walks.ends[edge][1 if forward is forwards else 0]
            other = next((one for one in walks.meeting[area] if one in left), None)
            if other is None:
                break
            del left[other]
            enters = walks.ends[other][0] == area
            chain.insert(len(chain) if forwards else 0, (other, enters if forwards else not enters))
    return chain
