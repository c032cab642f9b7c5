"""Reading of SUMO's network files.

It uses the standard library's XML reader: sumolib takes four times as long and hides the walking areas.
"""

import functools
import hashlib
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Mapping
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
    walk: bool
    """Whether pedestrians may use it."""
    width: float
    shape: Line
    """(n, 2), metres: the centre line, or a walking area's outline."""


@dataclass(frozen=True, eq=False)
class NetJunction:
    """A node of a net file."""

    id: str
    position: tuple[float, float]
    type: str
    """SUMO's type, such as ``priority`` or ``traffic_light``."""
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
    left_hand: bool
    """Whether traffic keeps to the left."""
    roundabouts: frozenset[str]
    """Ids of the junctions on roundabouts."""

    @functools.cached_property
    def streets(self) -> Mapping[str, list[NetLane]]:
        """Car lanes of each normal edge that has any, from the kerb to the street's axis."""
        found: dict[str, list[NetLane]] = defaultdict(list)
        for lane in self.lanes.values():
            if lane.function == "normal" and lane.cars and len(lane.shape) > 1:
                found[lane.edge].append(lane)
        return found

    @property
    def crossed(self) -> list[str]:
        """Ids of the nodes that have an area for cars."""
        used = {node for edge in self.streets for node in self.edges[edge]}
        return [node for node, one in self.junctions.items() if node in used and len(one.shape) > 2]

    @functools.cached_property
    def car_lanes(self) -> Mapping[str, str]:
        """Each street's lane for the car: the one that leads into most streets, next to the kerb."""

        def leads_into(lane: NetLane) -> int:
            return len({self.lanes[onward.to_lane].edge for onward in self.onward[lane.id]})

        return {edge: max(lanes, key=leads_into).id for edge, lanes in self.streets.items()}

    @functools.cached_property
    def onward(self) -> Mapping[str, list[NetConnection]]:
        """Connections from each lane."""
        found: dict[str, list[NetConnection]] = defaultdict(list)
        for connection in self.connections:
            found[connection.from_lane].append(connection)
        return found


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a net as canonical XML, without comments: they hold the time and paths of its making."""
    canonical = ET.canonicalize(path.read_text("utf-8"), with_comments=False, strip_text=True)
    return hashlib.sha256(canonical.encode()).hexdigest()


def shape_of(text: str) -> Line:
    """Return SUMO's ``x,y x,y`` as a read-only array (n, 2)."""
    line = np.array([[float(value) for value in point.split(",")[:2]] for point in text.split()], np.float64)
    line.flags.writeable = False
    return line


def _may_use(lane: ET.Element, who: str) -> bool:
    allow, disallow = lane.get("allow"), lane.get("disallow", "")
    if allow is not None:
        return who in allow.split() or allow == "all"
    return who not in disallow.split() and disallow != "all"


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
                cars=_may_use(lane, "passenger"),
                walk=_may_use(lane, "pedestrian"),
                width=float(lane.get("width", "3.2")),
                shape=shape_of(lane.attrib["shape"]),
            )
    junctions = {
        node.attrib["id"]: NetJunction(
            id=node.attrib["id"],
            position=(float(node.attrib["x"]), float(node.attrib["y"])),
            type=node.attrib["type"],
            shape=shape_of(node.get("shape", "")) if node.get("shape") else np.empty((0, 2)),
        )
        for node in root.iter("junction")
        if node.attrib["type"] != "internal"
    }
    on_roundabouts = {node for one in root.iter("roundabout") for node in one.get("nodes", "").split()}
    left_hand = root.get("lefthand", "false") in {"true", "1"}
    return Net(lanes, junctions, edges, _connections(root, lanes), left_hand, frozenset(on_roundabouts))


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
        if element.get("dir") == "t":  # turns round
            continue
        via: list[str] = []
        step: str | None = element.get("via")
        while step is not None:
            via.append(step)
            step = onward[step][0].get("via") if onward[step] else None
        found.append(NetConnection(start, end, tuple(via)))
    return tuple(found)
