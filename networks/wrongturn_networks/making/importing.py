"""Towns of other programs: SUMO networks, OpenDRIVE and OpenStreetMap become the folder of a town.

What the vocabulary of trials does not hold, such as a roundabout, is left out with its reason; the rest works.
"""

import gzip
import json
import math
import os
import re
import subprocess
import tempfile
import xml.etree.ElementTree as ET
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from shapely import MultiPoint, Polygon

from wrongturn_networks.errors import ImportTownError, NetworkError
from wrongturn_networks.loading import read_town
from wrongturn_networks.making.checking import unfit
from wrongturn_networks.making.netconvert import netconvert, version
from wrongturn_networks.making.placing import Built, place_scenery
from wrongturn_networks.netfile import Net, read_net, sha256_of, shape_of
from wrongturn_networks.scenery import SceneryKind, SceneryObject, scenery_toml, sha256_of_scenery
from wrongturn_networks.town import Town

FARTHEST: Final = 50_000.0
"""Coordinates are at most this, metres: agents get them as 32-bit numbers, which are then good to 4 mm."""
STOREY: Final = 3.0
"""Height of a building's level, metres."""
_NAME: Final = r"[A-Za-z][A-Za-z0-9_-]{0,39}"
_SHAPES: Final = ("--junctions.corner-detail=8", "--junctions.internal-link-detail=12", "--no-turnarounds")
_TYPES: Final = "--type-files="
"""Option with the names of files that lie in SUMO's folder of type maps."""
_OPTIONS: Final = {
    "net": (),
    # Without these types netconvert drops sidewalks, or takes them for lanes of all vehicles.
    "OpenDRIVE": (
        f"{_TYPES}opendriveNetconvert.typ.xml,opendriveNetconvertPedestrians.typ.xml",
        "--walkingareas",
        "--offset.disable-normalization",
        *_SHAPES,
    ),
    "osm": (
        "--keep-edges.by-vclass=passenger",
        "--geometry.remove",
        "--roundabouts.guess",
        "--junctions.join",
        "--osm.sidewalks",
        "--walkingareas",
        "--default.sidewalk-width=2.5",
        "--default.junctions.radius=7",
        *_SHAPES,
    ),
}
"""netconvert's options by the root element of a file; a SUMO network is taken as it is."""
_INPUTS: Final = {"OpenDRIVE": "--opendrive-files", "osm": "--osm-files"}


@dataclass(frozen=True)
class Imported:
    """A town that was imported."""

    town: Town
    left_out: dict[str, str]
    """Why junctions of the file, or single approaches, were left out: by the ids of nodes and lanes in the net."""
    warnings: tuple[str, ...]
    """What netconvert said."""


def import_town(
    file: Path, folder: Path, *, left_hand: bool = False, seed: int = 1, options: tuple[str, ...] = ()
) -> Imported:
    """Write the folder of a town from a SUMO network, an OpenDRIVE or an OSM file, with scenery from a seed.

    The folder's name is the town's. ``options`` go to netconvert. Buildings are OSM's where the file has some. Raises
    ImportTownError if the file cannot be read, has no junction that works, or the folder is not empty.
    """
    if not re.fullmatch(_NAME, folder.name) or folder.name.startswith(("drawn-", "training-")):
        raise ImportTownError(
            f"--name: {folder.name!r} cannot be a town's name; use a letter, then up to 39 letters, digits, - and _"
        )
    if folder.exists() and any(folder.iterdir()):
        raise ImportTownError(f"{folder} is not empty; name another folder or another --name")
    kind = _kind_of(file)
    if kind == "net" and left_hand:
        raise ImportTownError("--left-hand: a SUMO network says itself on which side its traffic drives; leave it out")
    with tempfile.TemporaryDirectory() as scratch:
        made = Path(scratch) / folder.name
        made.mkdir()
        net_file = made / f"{folder.name}.net.xml"
        told = (*_OPTIONS[kind], *(("--lefthand",) if left_hand else ()), *options)
        warnings = _write_net(file, kind, net_file, told)
        net = _read(net_file, file)
        names, left_out = _junctions(net, folder.name)
        manifest: dict[str, Any] = {
            "town": folder.name,
            "source": file.name,
            "format": "SUMO" if kind == "net" else kind,
            "sumo": version(),
            "options": list(told),
            "seed": seed,
            "junctions": names,
            "left_out": left_out,
            "net_sha256": sha256_of(net_file),
        }
        _write(made, manifest, ())
        houses = _buildings(file, net_file, Path(scratch)) if kind == "osm" else ()
        _write(made, manifest, place_scenery(read_town(made), seed, built=houses))
        folder.mkdir(parents=True, exist_ok=True)
        for one in made.iterdir():
            (folder / one.name).write_bytes(one.read_bytes())
    return Imported(read_town(folder), left_out, tuple(warnings))


def _kind_of(file: Path) -> str:
    """Return the root element of a file that can be imported: ``net``, ``OpenDRIVE`` or ``osm``."""
    try:
        with gzip.open(file) if file.suffix == ".gz" else file.open("rb") as opened:
            root = ""
            for number, (_, element) in enumerate(ET.iterparse(opened, ("start",))):
                root = root or element.tag
                if root == "osm" and element.tag == "tag" and element.get("v") in {"lanelet", "lanelet2"}:
                    raise ImportTownError(
                        f"{file}: is a Lanelet2 map, which has the suffix .osm but not OpenStreetMap's roads; convert "
                        "it to OpenDRIVE first"
                    )
                if root != "osm" or number > 200_000:
                    break
    except FileNotFoundError:
        raise ImportTownError(f"{file}: there is no such file") from None
    except (OSError, EOFError, ET.ParseError) as error:
        raise ImportTownError(
            f"{file}: cannot be read as XML ({error}); give a .net.xml, .xodr or .osm file"
        ) from error
    if root not in _OPTIONS:
        raise ImportTownError(
            f"{file}: its root element is <{root[:40]}>; give a SUMO network <net>, an <OpenDRIVE> or an <osm> file"
        )
    return root


def _write_net(file: Path, kind: str, net_file: Path, options: tuple[str, ...]) -> list[str]:
    """Write the net of a file without netconvert's comments, and return netconvert's warnings."""
    warnings: list[str] = []
    if kind != "net" or options:
        raw = net_file.with_suffix(".raw")
        given = [_INPUTS.get(kind, "--sumo-net-file"), str(file.resolve())]
        home = netconvert().parent.parent
        told = [_with_folder(option, home / "data" / "typemap") for option in options]
        command: list[str | Path] = [netconvert(), "-X", "never", *given, "-o", raw, *told]
        there = os.environ | {"SUMO_HOME": str(home)}
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=there)
        said = [line.strip() for line in done.stderr.splitlines() if line.strip()]
        if done.returncode or not raw.exists():
            errors = [line for line in said if line.startswith("Error")] or said[-3:]
            raise ImportTownError(f"{file}: netconvert rejects it: {' '.join(errors)[:600]}")
        warnings = [line for line in said if line.startswith("Warning")]
        file = raw
    with gzip.open(file) if file.suffix == ".gz" else file.open("rb") as opened:
        ET.parse(opened).write(net_file, "utf-8", xml_declaration=True)
    net_file.with_suffix(".raw").unlink(missing_ok=True)
    return warnings


def _with_folder(option: str, folder: Path) -> str:
    names = option.removeprefix(_TYPES)
    return option if names == option else _TYPES + ",".join(str(folder / name) for name in names.split(","))


def _read(net_file: Path, file: Path) -> Net:
    try:
        net = read_net(net_file)
    except (ValueError, KeyError, IndexError) as error:
        raise ImportTownError(
            f"{file}: is no complete SUMO network ({error!r}); write it again by netconvert"
        ) from error
    far = max((abs(value) for node in net.junctions.values() for value in node.position), default=0.0)
    if far > FARTHEST:
        raise ImportTownError(
            f"{file}: has coordinates up to {far:.0f} m, and {FARTHEST:.0f} is the limit; convert it with "
            "--option=--offset.disable-normalization=false, or by netconvert, which moves it to 0"
        )
    if not net.streets:
        raise ImportTownError(f"{file}: has no road on which passenger cars may drive; check its vehicle classes")
    return net


def _junctions(net: Net, name: str) -> tuple[dict[str, str], dict[str, str]]:
    """Return the nodes of the junctions that work by their names, and the reasons of those that do not, by node."""
    works, reasons = unfit(net, name)
    if not works:
        kinds = Counter(reason.partition(":")[0] for reason in reasons.values())
        said = ", ".join(f"{kind} {count}" for kind, count in kinds.most_common(5)) or "no three streets meet"
        raise ImportTownError(f"{name}: none of its junctions works: {said}")
    position = {node: net.junctions[node].position for node in works}
    # From north to south, so that the names help to find one on the map.
    ordered = sorted(works, key=lambda node: (-round(position[node][1] / 50.0), position[node][0]))
    return {f"J{number}": node for number, node in enumerate(ordered, 1)}, reasons


def _write(folder: Path, manifest: dict[str, Any], scenery: tuple[SceneryObject, ...]) -> None:
    (folder / "scenery.toml").write_text(scenery_toml(scenery), "utf-8")
    whole = manifest | {"scenery_sha256": sha256_of_scenery(folder / "scenery.toml")}
    (folder / "manifest.json").write_text(json.dumps(whole, indent=2) + "\n", "utf-8")


def _buildings(file: Path, net_file: Path, scratch: Path) -> tuple[Built, ...]:
    """Return OSM's buildings as boxes: kind, x, y, yaw and length, width, height; metres, radians."""
    types, found = scratch / "types.xml", scratch / "buildings.xml"
    types.write_text('<polygonTypes><polygonType id="building" name="building"/></polygonTypes>', "utf-8")
    command: list[str | Path] = [
        netconvert().with_name("polyconvert"),
        "-X",
        "never",
        "-n",
        net_file,
        "--osm-files",
        file.resolve(),
    ]
    command += ["--type-file", types, "--discard", "--osm.keep-full-type", "--all-attributes", "-o", found]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode or not found.exists():
        return ()
    boxes = []
    for poly in ET.parse(found).getroot().iter("poly"):
        shape = shape_of(poly.get("shape", ""))
        if len(shape) < 4 or not poly.get("type", "").startswith("building"):
            continue
        box = MultiPoint(shape).minimum_rotated_rectangle
        if not isinstance(box, Polygon):
            continue
        (ax, ay), (bx, by), (cx, cy) = list(box.exterior.coords)[:3]
        tags = {one.get("key"): one.get("value", "") for one in poly.iter("param")}
        height = _number(tags.get("height")) or STOREY * (_number(tags.get("building:levels")) or 2.0)
        size = math.dist((ax, ay), (bx, by)), math.dist((bx, by), (cx, cy)), min(max(height, 2.5), 60.0)
        if min(size[:2]) > 1.0:
            x, y = box.centroid.coords[0]
            boxes.append((SceneryKind.HOUSE, x, y, math.atan2(by - ay, bx - ax), size))
    return tuple(boxes)


def _number(text: str | None) -> float | None:
    found = re.match(r"\s*(\d+(?:\.\d+)?)", text or "")
    return float(found[1]) if found else None


def check_folder(folder: Path) -> list[str]:
    """Return all that keeps a folder from being a town; nothing if it is one."""
    flaws = []
    needed = ("manifest.json", f"{folder.name}.net.xml", "scenery.toml")
    flaws += [f"{folder / name} is missing" for name in needed if not (folder / name).is_file()]
    if flaws:
        hint = "; 'wrongturn towns import FILE' makes a town of it" if any(folder.glob("*.net.xml")) else ""
        return [flaw + hint for flaw in flaws]
    try:
        read_town(folder)
    except NetworkError as error:
        flaws.append(str(error))
    try:
        net = read_net(folder / f"{folder.name}.net.xml")
        manifest = json.loads((folder / "manifest.json").read_text("utf-8"))
        reasons, told = unfit(net, folder.name)[1], manifest.get("left_out", {})
        counted = {str(node) for node in manifest.get("junctions", {}).values()}
        for place, reason in reasons.items():
            if place in counted or (reason.partition(": ")[0] in counted and place not in told):
                flaws.append(f"{place}: {reason}")
    except (OSError, ValueError, KeyError, IndexError, SyntaxError, AttributeError) as error:
        flaws.append(f"{folder.name}.net.xml: {error!r}; write it again by netconvert")
    return flaws
