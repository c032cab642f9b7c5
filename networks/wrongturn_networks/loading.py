"""Loading of towns: from a folder with a net and scenery to a :class:`~wrongturn_networks.town.Town`."""

import functools
import json
import re
from collections import defaultdict
from collections.abc import Container, Iterable, Mapping, Sequence, Set
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from shapely import union

from wrongturn_networks import drivable
from wrongturn_networks.boards import with_boards
from wrongturn_networks.drawn import is_drawn, load_drawn
from wrongturn_networks.errors import CorruptFileError, UnknownTownError
from wrongturn_networks.junctions import Approach, Exit, Junction, arms_of, direction_of
from wrongturn_networks.lanes import Lane, Line, heading_of
from wrongturn_networks.netfile import Net, NetConnection, NetLane, read_net, sha256_of
from wrongturn_networks.scenery import read_scenery, scenery_toml, sha256_of_scenery
from wrongturn_networks.shelf import Shelf
from wrongturn_networks.town import Town, sha256_of_town
from wrongturn_protocol import DIRECTIONS, JunctionType, Trial
from wrongturn_protocol.home import home

TOWNS: Final = Path(__file__).parent / "towns"


def town_names() -> tuple[str, ...]:
    """Return the names of all towns, those of other packages included, sorted."""
    return shelf().names()


def load_town(name: str, scenery: int | None = None) -> Town:
    """Return a town, which each process reads once, with drawn scenery if ``scenery`` is its seed.

    A drawn town is built where it is missing. Raises UnknownTownError; CorruptFileError for broken files;
    TownBuildError if a drawn town cannot be built.
    """
    town = load_drawn(name) if is_drawn(name) else shelf().load(name)
    return town if scenery is None else _with_scenery(town, scenery)


def town_of(trial: Trial) -> Town:
    """Return the town that a trial is driven in: with its scenery and, if its fault closes a street, with boards.

    Raises as :func:`load_town`, and UnknownApproachError.
    """
    from wrongturn_networks.faults import closed_exit  # noqa: PLC0415 - it draws trials in towns, so it comes later

    town, closed = load_town(trial.town, trial.scenery), closed_exit(trial)
    return town if closed is None else with_boards(town, trial.approach, closed)


@functools.lru_cache(maxsize=32)
def _with_scenery(town: Town, seed: int) -> Town:
    from wrongturn_networks.making.placing import place_scenery  # noqa: PLC0415 - it reads towns, so it comes later

    return town.with_scenery(place_scenery(town, seed), seed)


def read_town(directory: Path) -> Town:
    """Return the town in a folder of its name. Raises CorruptFileError if a file is missing or not the manifest's."""
    name = directory.name
    try:
        manifest = json.loads((directory / "manifest.json").read_text("utf-8"))
        net_file, scenery_file = directory / f"{name}.net.xml", directory / "scenery.toml"
        _check(net_file.name, sha256_of(net_file), manifest["net_sha256"])
        _check(scenery_file.name, sha256_of_scenery(scenery_file), manifest["scenery_sha256"])
        net = read_net(net_file)
        # An imported net has names of its own; those of the junctions are short and the same everywhere.
        names = manifest.get("junctions") or {junction: junction for junction in manifest["radii"]}
        nodes = {net.junctions[node].id: str(junction) for junction, node in names.items()}
        sha256 = sha256_of_town(manifest["net_sha256"], manifest["scenery_sha256"])
    except CorruptFileError:
        raise
    except (OSError, ValueError, KeyError, TypeError, AttributeError, SyntaxError) as error:
        raise CorruptFileError(f"town {name}: {error}; install its package again, or build the town again") from error
    return town_of_net(
        net,
        nodes,
        net.crossed if "junctions" in manifest else None,
        manifest.get("left_out", ()),
        name=name,
        directory=directory,
        net_file=net_file,
        net_sha256=manifest["net_sha256"],
        sha256=sha256,
        scenery=read_scenery(scenery_file),
    )


def town_of_net(
    net: Net, nodes: Mapping[str, str], areas: Iterable[str] | None = None, left_out: Container[str] = (), **told: Any
) -> Town:
    """Return the town of a net, in which ``nodes`` are the junctions: their names by their ids in the net.

    ``areas`` are the ids of those nodes whose shapes are road, by default the junctions; ``left_out`` has lanes that
    are no approaches. ``told`` are the town's other fields.
    """
    lanes = _lanes(net, nodes)
    approaches = _approaches(net, lanes, set(nodes.values()), left_out)
    meeting = [net.junctions[node] for node in nodes]
    road = drivable.road(net, meeting if areas is None else [net.junctions[node] for node in areas])
    sidewalks = drivable.sidewalks(net).difference(road)
    return Town(
        lanes=MappingProxyType(lanes),
        junctions=MappingProxyType(
            {
                nodes[node.id]: Junction(
                    id=nodes[node.id],
                    position=node.position if areas is None else _middle(nodes[node.id], lanes.values()),
                    area=drivable.junction_area(node, road),
                    approaches=tuple(one.id for one in approaches.values() if one.junction == nodes[node.id]),
                )
                for node in meeting
            }
        ),
        approaches=MappingProxyType(approaches),
        road=road,
        sidewalks=sidewalks,
        bounds=union(road, sidewalks).bounds,
        **told,
    )


def write_town(town: Town, directory: Path) -> None:
    """Write a town's folder with the scenery that it has, over files of the same names there. Raises OSError."""
    directory.mkdir(parents=True, exist_ok=True)
    for file in town.directory.iterdir():
        (directory / file.name).write_bytes(file.read_bytes())
    scenery = directory / "scenery.toml"
    scenery.write_text(scenery_toml(town.scenery), "utf-8")
    manifest = json.loads((town.directory / "manifest.json").read_text("utf-8"))
    manifest |= {"scenery_sha256": sha256_of_scenery(scenery)}
    if town.scenery_seed is not None:
        manifest |= {"scenery_seed": town.scenery_seed}
    (directory / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n", "utf-8")


def _check(file: str, found: str, wanted: str) -> None:
    if found != wanted:
        raise CorruptFileError(
            f"town: {file} does not match its manifest; install its package again, or build the town again"
        )


def _lanes(net: Net, nodes: Mapping[str, str]) -> dict[str, Lane]:
    """Return each edge's lane for the car, and the lanes into which others lead."""
    streets, chosen = net.streets, net.car_lanes
    by_ends = defaultdict(list)
    for edge in streets:
        by_ends[net.edges[edge]].append(edge)
    entered = {onward.to_lane for lane in chosen.values() for onward in _leading(net, lane)}
    found = {}
    for edge, lanes in streets.items():
        start, end = net.edges[edge]
        backward = min(by_ends[end, start], key=lambda other: _apart(net, edge, other), default=None)
        for place, lane in enumerate(lanes):
            if lane.id != chosen[edge] and lane.id not in entered:
                continue
            beyond = sum(other.width for other in lanes[place + 1 :])
            middle, breadth = _carriageway(lanes, lane)
            found[lane.id] = Lane(
                id=lane.id,
                edge=edge,
                width=lane.width,
                length=float(np.hypot(*np.diff(lane.shape, axis=0).T).sum()),
                centreline=lane.shape,
                polygon=drivable.lane_polygon(middle, breadth),
                start_junction=nodes.get(start),
                end_junction=nodes.get(end),
                opposite=None if backward is None else chosen[backward],
                axis=(lane.width / 2 + beyond) * (-1.0 if net.left_hand else 1.0),
                kerb=lane.width / 2 + sum(other.width for other in lanes[:place]),
                middle=middle,
                breadth=breadth,
            )
    return found


def _leading(net: Net, lane: str) -> list[NetConnection]:
    """Return one connection from a lane into each edge, into the lane for the car if there is one."""
    best: dict[str, NetConnection] = {}
    for onward in net.onward[lane]:
        edge = net.lanes[onward.to_lane].edge
        if edge not in best or onward.to_lane == net.car_lanes[edge]:
            best[edge] = onward
    return [*best.values()]


def _apart(net: Net, edge: str, other: str) -> float:
    """Return how far the ends of an edge are from those of one the other way, metres."""
    a, b = (net.lanes[f"{one}_0"].shape for one in (edge, other))
    return float(np.hypot(*(a[0] - b[-1])) + np.hypot(*(a[-1] - b[0])))


def _carriageway(lanes: Sequence[NetLane], own: NetLane) -> tuple[Line, float]:
    """Return the middle line and the width of an edge's car lanes; the lane's own if they do not run side by side."""
    first, last = lanes[0], lanes[-1]
    if len(lanes) == 1 or len(first.shape) != len(last.shape):
        return own.shape, own.width
    # The widths may differ, so the middle is not always that of the outer centre lines.
    breadth = sum(lane.width for lane in lanes)
    share = (breadth - first.width) / max(2 * breadth - first.width - last.width, 1e-9)
    middle: Line = first.shape + (last.shape - first.shape) * share
    middle.flags.writeable = False
    return middle, breadth


def _approaches(net: Net, lanes: dict[str, Lane], junctions: Set[str], left_out: Container[str]) -> dict[str, Approach]:
    """Return the approaches, except the lanes that are left out and those whose exits no junction type has."""
    arriving: dict[str, list[Lane]] = defaultdict(list)
    for lane in (lanes[name] for name in net.car_lanes.values()):
        if lane.end_junction is not None and lane.end_junction in junctions:
            arriving[lane.end_junction].append(lane)
    approaches = {}
    for junction, coming in arriving.items():
        headings = [heading_of(lane.centreline[-2:]) for lane in coming]
        for lane, heading, arm in zip(coming, headings, arms_of(headings), strict=True):
            exits = {}
            for connection in _leading(net, lane.id):
                onward = lanes[connection.to_lane]
                direction = direction_of(heading_of(onward.centreline[:2]) - heading)
                path = _joined(
                    [lane.centreline[-1:], *(net.lanes[via].shape for via in connection.via), onward.centreline[:1]]
                )
                exits[direction] = Exit(direction, onward.id, connection.via, path)
            if lane.id in left_out or frozenset(exits) not in {kind.exits for kind in JunctionType}:
                continue
            approach = Approach(
                id=f"{junction}-{arm}",
                junction=junction,
                lane=lane.id,
                type=JunctionType.of(frozenset(exits)),
                exits=MappingProxyType({command: exits[command] for command in DIRECTIONS if command in exits}),
                stop_line=(float(lane.centreline[-1, 0]), float(lane.centreline[-1, 1])),
                heading=heading,
            )
            approaches[approach.id] = approach
    return dict(sorted(approaches.items(), key=lambda item: _natural(item[0])))


def _middle(junction: str, lanes: Iterable[Lane]) -> tuple[float, float]:
    """Return where the axes of a junction's streets meet, by least squares: other programs put a node anywhere."""
    left, right = np.zeros((2, 2)), np.zeros(2)
    for lane in lanes:
        for place, piece in ((lane.end_junction, lane.centreline[-2:]), (lane.start_junction, lane.centreline[:2])):
            if place == junction:
                ux, uy = (piece[1] - piece[0]) / np.hypot(*(piece[1] - piece[0]))
                across = np.eye(2) - np.outer((ux, uy), (ux, uy))
                at = piece[1 if place == lane.end_junction else 0] + lane.axis * np.array((-uy, ux))
                left += across
                right += across @ at
    x, y = np.linalg.lstsq(left, right, rcond=None)[0].tolist()
    return x, y


def _natural(text: str) -> list[tuple[int, str]]:
    return [(int(number or 0), word) for number, word in re.findall(r"(\d+)|(\D+)", text)]


def _joined(pieces: list[Line]) -> Line:
    """Join the pieces of a path into one line, without repeated points."""
    points = np.concatenate(pieces)
    keep = np.concatenate([[True], np.abs(np.diff(points, axis=0)).sum(axis=1) > 1e-6])
    line: Line = points[keep]
    line.flags.writeable = False
    return line


@functools.cache
def shelf() -> Shelf[Town]:
    """Return all towns by their names."""
    folders = (file.parent for file in TOWNS.glob("*/manifest.json"))
    return Shelf("wrongturn.towns", folders, read_town, UnknownTownError, _own_towns, "WRONGTURN_TOWNS")


def town_named(text: str) -> str:
    """Return the name of the town that a user names, by its name or its folder, which is then known by its name.

    Raises NetworkError for a folder that is no town.
    """
    return shelf().name_of(text)


def _own_towns() -> list[Path]:
    """Return the folders of towns that the user made; those that secrets and training make lie beside them."""
    folders = (file.parent for file in (home() / "towns").glob("*/manifest.json"))
    return sorted(one for one in folders if not one.name.startswith(("drawn-", "training-", ".")))
