"""Reading of SUMO's network files.

It uses the standard library's XML reader: sumolib takes four times as long and hides the walking areas.
"""

import hashlib
import xml.etree.ElementTree as ET
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wrongturn_networks.lanes import Line


@dataclass(frozen=True, eq=False)
class NetLane:
    """A lane of a net file."""

    id: str
    edge: str
    function: str
    """Function of its edge: ``normal``, ``internal``, ``walkingarea`` or ``crossing``."""
    cars: bool
    width: float
    shape: Line
    """(n, 2), metres: the centre line, or a walking area's outline."""


@dataclass(frozen=True, eq=False)
class NetJunction:
    """A node of a net file."""

    id: str
    position: tuple[float, float]
    shape: Line
    """Outline, (n, 2), metres."""


@dataclass(frozen=True, eq=False)
class NetConnection:
    """A permitted movement between car lanes of normal edges."""

    from_lane: str
    to_lane: str
    via: tuple[str, ...]
    """Internal lanes, in the order of travel."""


@dataclass(frozen=True, eq=False)
class Net:
    """The content of a net file."""

    lanes: dict[str, NetLane]
    junctions: dict[str, NetJunction]
    edges: dict[str, tuple[str, str]]
    """Start node and end node of each normal edge."""
    connections: tuple[NetConnection, ...]


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a net as canonical XML, without comments: they hold the time and paths of its making."""
    canonical = ET.canonicalize(path.read_text("utf-8"), with_comments=False, strip_text=True)
    return hashlib.sha256(canonical.encode()).hexdigest()


def shape_of(text: str) -> Line:
    """Return SUMO's ``x,y x,y`` as a read-only array (n, 2)."""
    line = np.array([[float(value) for value in point.split(",")[:2]] for point in text.split()], np.float64)
    line.flags.writeable = False
    return line


def _cars_may_use(lane: ET.Element) -> bool:
    allow, disallow = lane.get("allow"), lane.get("disallow", "")
    if allow is not None:
        return "passenger" in allow.split() or allow == "all"
    return "passenger" not in disallow.split() and disallow != "all"


def read_net(path: Path) -> Net:
    """Read a SUMO net file. Raises OSError, and ElementTree's ParseError if the file is not XML."""
    root = ET.parse(path).getroot()  # noqa: S314 - a file of this package, with a checksum
    lanes: dict[str, NetLane] = {}
    edges: dict[str, tuple[str, str]] = {}
    for edge in root.iter("edge"):
        function = edge.get("function", "normal")
        if function == "normal":
            edges[edge.attrib["id"]] = (edge.attrib["from"], edge.attrib["to"])
        for lane in edge.iter("lane"):
            lanes[lane.attrib["id"]] = NetLane(
                id=lane.attrib["id"],
                edge=edge.attrib["id"],
                function=function,
                cars=_cars_may_use(lane),
                width=float(lane.get("width", "3.2")),
                shape=shape_of(lane.attrib["shape"]),
            )
    junctions = {
        node.attrib["id"]: NetJunction(
            id=node.attrib["id"],
            position=(float(node.attrib["x"]), float(node.attrib["y"])),
            shape=shape_of(node.get("shape", "")) if node.get("shape") else np.empty((0, 2)),
        )
        for node in root.iter("junction")
        if node.attrib["type"] != "internal"
    }
    return Net(lanes, junctions, edges, _connections(root, lanes))


def _connections(root: ET.Element, lanes: dict[str, NetLane]) -> tuple[NetConnection, ...]:
    raw = list(root.iter("connection"))
    onward: dict[str, list[ET.Element]] = defaultdict(list)
    for element in raw:
        onward[f"{element.attrib['from']}_{element.attrib['fromLane']}"].append(element)
    found = []
    for element in raw:
        start = f"{element.attrib['from']}_{element.attrib['fromLane']}"
        end = f"{element.attrib['to']}_{element.attrib['toLane']}"
        if start not in lanes or lanes[start].function != "normal" or not lanes[start].cars or not lanes[end].cars:
            continue
        via: list[str] = []
        step: str | None = element.get("via")
        while step is not None:
            via.append(step)
            step = onward[step][0].get("via") if onward[step] else None
        found.append(NetConnection(start, end, tuple(via)))
    return tuple(found)
