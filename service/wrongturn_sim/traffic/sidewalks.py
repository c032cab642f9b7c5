"""A town's sidewalks, read from its net."""

import xml.etree.ElementTree as ET
from collections import defaultdict
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from wrongturn_networks import Town
from wrongturn_networks.lanes import Line
from wrongturn_networks.netfile import shape_of


def along_of(line: Line) -> NDArray[np.float64]:
    """Return the distance from a line's start to each of its points (n, 2), as (n,), metres."""
    steps = np.diff(line, axis=0)
    return np.concatenate(([0.0], np.cumsum(np.sqrt(steps[:, 0] ** 2 + steps[:, 1] ** 2))))


def length_of(line: Line) -> float:
    """Return the length of a line (n, 2), metres."""
    return float(along_of(line)[-1])


@dataclass(frozen=True, eq=False)
class Sidewalks:
    """Sidewalks of a town; each joins two walking areas."""

    lines: dict[str, Line]
    """Centre line of each edge's sidewalk, (n, 2), in the edge's direction."""
    ends: dict[str, tuple[str, str]]
    """Walking areas at the start and the end of each edge's sidewalk."""
    meeting: dict[str, tuple[str, ...]]
    """Edges whose sidewalks meet at a walking area."""


@lru_cache(maxsize=16)
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
