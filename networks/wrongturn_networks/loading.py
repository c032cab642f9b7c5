"""Loading of towns: from a folder with a net and scenery to a :class:`~wrongturn_networks.town.Town`."""

import functools
import json
import re
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np
from shapely import union

from wrongturn_networks import drivable
from wrongturn_networks.boards import with_boards
from wrongturn_networks.drawn import is_drawn, load_drawn
from wrongturn_networks.errors import CorruptFileError, UnknownTownError
from wrongturn_networks.junctions import Approach, Exit, Junction, arm_of, direction_of
from wrongturn_networks.lanes import Lane, Line, heading_of
from wrongturn_networks.netfile import Net, read_net, sha256_of
from wrongturn_networks.scenery import read_scenery, scenery_toml, sha256_of_scenery
from wrongturn_networks.shelf import Shelf
from wrongturn_networks.town import Town, sha256_of_town
from wrongturn_protocol import DIRECTIONS, JunctionType, Trial

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
        radii = {junction: float(radius) for junction, radius in manifest["radii"].items()}
        sha256 = sha256_of_town(manifest["net_sha256"], manifest["scenery_sha256"])
    except CorruptFileError:
        raise
    except (OSError, ValueError, KeyError, TypeError, AttributeError, SyntaxError) as error:
        raise CorruptFileError(f"town {name}: {error}; install its package again") from error
    lanes = _lanes(net, radii)
    approaches = _approaches(net, lanes)
    meeting = [net.junctions[junction] for junction in radii]
    road = drivable.road(net, meeting)
    sidewalks = drivable.sidewalks(net).difference(road)
    junctions = {
        node.id: Junction(
            id=node.id,
            position=node.position,
            radius=radii[node.id],
            area=drivable.junction_area(node, road),
            approaches=tuple(approach.id for approach in approaches.values() if approach.junction == node.id),
        )
        for node in meeting
    }
    return Town(
        name=name,
        directory=directory,
        net_file=net_file,
        net_sha256=manifest["net_sha256"],
        sha256=sha256,
        lanes=MappingProxyType(lanes),
        junctions=MappingProxyType(junctions),
        approaches=MappingProxyType(approaches),
        road=road,
        sidewalks=sidewalks,
        scenery=read_scenery(scenery_file),
        bounds=union(road, sidewalks).bounds,
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


def _lanes(net: Net, radii: dict[str, float]) -> dict[str, Lane]:
    by_street = {
        net.edges[lane.edge]: lane.id for lane in net.lanes.values() if lane.function == "normal" and lane.cars
    }
    lanes = {}
    for (start, end), lane_id in by_street.items():
        lane = net.lanes[lane_id]
        steps = np.diff(lane.shape, axis=0)
        lanes[lane_id] = Lane(
            id=lane_id,
            edge=lane.edge,
            width=lane.width,
            length=float(np.sqrt((steps**2).sum(axis=1)).sum()),
            centreline=lane.shape,
            polygon=drivable.lane_polygon(lane.shape, lane.width),
            start_junction=start if start in radii else None,
            end_junction=end if end in radii else None,
            opposite=by_street.get((end, start)),
        )
    return lanes


def _approaches(net: Net, lanes: dict[str, Lane]) -> dict[str, Approach]:
    approaches = {}
    for lane in lanes.values():
        if lane.end_junction is None:
            continue
        heading = heading_of(lane.centreline[-2:])
        exits = {}
        for connection in net.connections:
            if connection.from_lane == lane.id:
                onward = lanes[connection.to_lane]
                direction = direction_of(heading_of(onward.centreline[:2]) - heading)
                path = _joined(
                    [lane.centreline[-1:], *(net.lanes[via].shape for via in connection.via), onward.centreline[:1]]
                )
                exits[direction] = Exit(direction, onward.id, connection.via, path)
        approach = Approach(
            id=f"{lane.end_junction}-{arm_of(heading)}",
            junction=lane.end_junction,
            lane=lane.id,
            type=JunctionType.of(frozenset(exits)),
            exits=MappingProxyType({command: exits[command] for command in DIRECTIONS if command in exits}),
            stop_line=(float(lane.centreline[-1, 0]), float(lane.centreline[-1, 1])),
            heading=heading,
        )
        approaches[approach.id] = approach
    return dict(sorted(approaches.items(), key=lambda item: _natural(item[0])))


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
    return Shelf("wrongturn.towns", folders, read_town, UnknownTownError)
