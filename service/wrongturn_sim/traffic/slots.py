"""Where other road users may start: slots, apart from each other and away from the ego; and the town's sidewalks."""

import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_networks import Town
from wrongturn_networks.lanes import Line
from wrongturn_networks.netfile import shape_of
from wrongturn_networks.per_net import once_per_net
from wrongturn_sim.polyline import measure

CLEARANCE: Final = 15.0
"""Least distance of a car's front from the ego's centre at the start, metres."""
PEDESTRIAN_CLEARANCE: Final = 5.0
"""Least distance of a pedestrian from the ego's centre at the start, metres."""
FIRST: Final = 6.5
"""First slot of a lane, metres from its start: a whole body fits behind the front bumper."""
JITTER: Final = 1.5
"""A car's front is up to this far past its slot, metres."""
_PITCH: Final = 10.0  # between slots: the longest body, the jitter and SUMO's gap between standing cars
_LAST: Final = 3.0  # between the last front and the stop line
_PACE: Final = 2.0  # of sidewalk for each pedestrian


@dataclass(frozen=True, eq=False)
class Sidewalks:
    """Sidewalks of a town; each joins two walking areas."""

    lines: dict[str, Line]
    """Centre line of each edge's sidewalk, (n, 2), in the edge's direction."""
    ends: dict[str, tuple[str, str]]
    """Walking areas at the start and the end of each edge's sidewalk."""
    meeting: dict[str, tuple[str, ...]]
    """Edges whose sidewalks meet at a walking area."""


@once_per_net(16)
def sidewalks_of(town: Town) -> Sidewalks:
    """Return the sidewalks that join others at both ends."""
    root = ET.parse(town.net_file).getroot()  # noqa: S314 - a file of the town, whose checksum was compared
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
        {edge: lines[lanes[edge]] for edge in ends}, ends, {area: tuple(edges) for area, edges in meeting.items()}
    )


@dataclass(frozen=True, eq=False)
class Slots:
    """Places where road users may start."""

    places: tuple[tuple[str, float], ...]
    """Lane or edge of each slot, and metres along it."""
    points: NDArray[np.float64]
    """(n, 2): position of each slot, metres."""
    clearance: float
    """Least distance from the ego's start, metres."""

    def free(self, x: float, y: float) -> list[int]:
        """Return the indices of the slots that are far enough from the ego's start, in order."""
        dx, dy = self.points[:, 0] - x, self.points[:, 1] - y
        indices: list[int] = np.flatnonzero(dx * dx + dy * dy >= self.clearance**2).tolist()
        return indices


@once_per_net(16)
def car_slots(town: Town) -> Slots:
    """Return the places for front bumpers; neighbours stay apart whatever their bodies and jitter are."""
    lines = {name: lane.centreline for name, lane in town.lanes.items()}
    return _slots(lines, FIRST, _PITCH, _LAST + JITTER, CLEARANCE)


@once_per_net(16)
def pedestrian_slots(town: Town) -> Slots:
    """Return the places for pedestrians."""
    return _slots(sidewalks_of(town).lines, _PACE, _PACE, _PACE, PEDESTRIAN_CLEARANCE)


def _slots(lines: Mapping[str, Line], first: float, pitch: float, last: float, clearance: float) -> Slots:
    places: list[tuple[str, float]] = []
    points = [np.empty((0, 2))]
    for name, line in sorted(lines.items()):
        along = measure(line)
        at = np.arange(first, float(along[-1]) - last, pitch)
        places += [(name, place) for place in at.tolist()]
        points.append(np.column_stack((np.interp(at, along, line[:, 0]), np.interp(at, along, line[:, 1]))))
    return Slots(tuple(places), np.concatenate(points), clearance)
