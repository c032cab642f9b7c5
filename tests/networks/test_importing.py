"""Towns of other programs: the same town through each format, what is left out and why, and bad files."""

import math
import subprocess
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from wrongturn_networks import Town, load_town, read_town
from wrongturn_networks.errors import ImportTownError
from wrongturn_networks.making.importing import check_folder, import_town
from wrongturn_networks.making.netconvert import netconvert

VILLAGE = Path(__file__).parents[2] / "docs" / "examples" / "village.osm"
LAT, LON = 50.0, 9.0
PLANE = f"--proj=+proj=tmerc +lat_0={LAT} +lon_0={LON} +k=1 +ellps=WGS84"
NEAR = 0.5
"""Metres."""


def as_osm(town: Town) -> str:
    """Return the streets of a town as OpenStreetMap's ways."""
    # Metres of a degree on the ellipsoid.
    sin = math.sin(math.radians(LAT))
    curved = 1.0 - 0.00669438 * sin * sin
    north = math.pi / 180 * 6378137.0 * (1 - 0.00669438) / curved**1.5
    east = math.pi / 180 * 6378137.0 * math.cos(math.radians(LAT)) / math.sqrt(curved)
    nodes: dict[tuple[float, float], int] = {}
    ways = []
    for lane in town.lanes.values():
        assert lane.opposite is not None
        if lane.id > lane.opposite:
            continue
        steps = np.gradient(lane.centreline, axis=0)
        left = np.stack([-steps[:, 1], steps[:, 0]], 1) / np.hypot(*steps.T)[:, None]
        line = (lane.centreline + lane.axis * left).tolist()
        for end, place in ((lane.start_junction, 0), (lane.end_junction, -1)):
            if end is not None:
                line[place] = list(town.junctions[end].position)
        refs = [nodes.setdefault((round(x, 3), round(y, 3)), len(nodes) + 1) for x, y in line]
        ways.append(refs)
    found = [
        f'<node id="{key}" version="1" lat="{LAT + y / north:.9f}" lon="{LON + x / east:.9f}"/>'
        for (x, y), key in nodes.items()
    ]
    for number, refs in enumerate(ways, 1):
        points = "".join(f'<nd ref="{ref}"/>' for ref in refs)
        found.append(f'<way id="{number}" version="1">{points}<tag k="highway" v="residential"/></way>')
    return f'<osm version="0.6">{"".join(found)}</osm>'


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, tuple[str, ...]]]:
    """Town01 in each format, with the options of its import."""
    town, folder = load_town("Town01"), tmp_path_factory.mktemp("formats")
    drive, osm = folder / "Town01.xodr", folder / "Town01.osm"
    subprocess.run([netconvert(), "-s", town.net_file, "--opendrive-output", drive], check=True, capture_output=True)
    osm.write_text(as_osm(town), "utf-8")
    osm_options = (PLANE, "--offset.disable-normalization", "--default.lanewidth=4")
    return {"net": (town.net_file, ()), "xodr": (drive, ()), "osm": (osm, osm_options)}


@pytest.mark.parametrize("kind", ["net", "xodr", "osm"])
def test_a_town_is_the_same_through_each_format(
    files: dict[str, tuple[Path, tuple[str, ...]]], tmp_path: Path, kind: str
) -> None:
    file, options = files[kind]
    found = import_town(file, tmp_path / "again", options=options)
    assert not found.left_out
    town, ours = found.town, load_town("Town01")
    for junction in ours.junctions.values():
        other = min(town.junctions.values(), key=lambda one: math.dist(one.position, junction.position))
        assert math.dist(other.position, junction.position) < NEAR
        types = [
            {town.approaches[one].type for one in other.approaches},
            {ours.approaches[one].type for one in junction.approaches},
        ]
        assert types[0] == types[1]
    inner = [lane for lane in ours.lanes.values() if lane.start_junction and lane.end_junction]
    assert len(inner) == sum(bool(lane.start_junction and lane.end_junction) for lane in town.lanes.values())
    for lane in inner:
        middle = lane.polygon.centroid
        other_lane = min(town.lanes.values(), key=lambda one: one.polygon.centroid.distance(middle))
        assert other_lane.polygon.buffer(NEAR).contains(lane.polygon.buffer(-NEAR).buffer(-0.01))
        assert heading_apart(other_lane.centreline, lane.centreline) < 0.02
    assert not check_folder(tmp_path / "again")


def heading_apart(a: np.ndarray, b: np.ndarray) -> float:
    """Return the angle between the ways from start to end of two lines, radians."""
    turns = [math.atan2(*(line[-1] - line[0])[::-1]) for line in (a, b)]
    return abs(math.remainder(turns[0] - turns[1], math.tau))


def test_a_village_of_openstreetmap(tmp_path: Path) -> None:
    found = import_town(VILLAGE, tmp_path / "village")
    kinds = Counter(reason.partition(":")[0] for place, reason in found.left_out.items() if "_" not in place)
    assert kinds == {"signals": 1, "roundabout": 3}
    assert {reason.split(": ")[1] for place, reason in found.left_out.items() if "_" in place} == {"exits"}
    assert Counter(one.type.value for one in found.town.approaches.values())["CROSS"] == 15
    assert sum(thing.kind == "house" and 9 < thing.length < 16 for thing in found.town.scenery) >= 15
    assert read_town(tmp_path / "village").sha256 == found.town.sha256
    again = import_town(VILLAGE, tmp_path / "other" / "village").town
    assert again.sha256 == found.town.sha256, "the same file and seed make the same town"


def test_left_hand_traffic_lies_on_the_left(tmp_path: Path) -> None:
    town = import_town(VILLAGE, tmp_path / "village", left_hand=True).town
    assert all(lane.axis < 0 for lane in town.lanes.values())
    for lane in town.lanes.values():
        if lane.opposite is not None:
            (x, y), (x2, y2) = lane.centreline[:2].tolist()
            ox, oy = town.lanes[lane.opposite].centreline[-1].tolist()
            assert (x2 - x) * (oy - y) - (y2 - y) * (ox - x) < 0, "oncoming traffic is on the right"


def roadrunner() -> str:
    """Return OpenDRIVE as RoadRunner writes it: a T-junction whose roads have two lanes and sidewalks."""
    lane = '<lane id="{0}" type="{1}" level="false">{2}<width sOffset="0" a="{3}" b="0" c="0" d="0"/></lane>'
    plan = '<planView><geometry s="0" x="{}" y="{}" hdg="{}" length="{}">{}</geometry></planView>'
    section = (
        '<lanes><laneSection s="0">{}<center><lane id="0" type="none" level="false"/></center>{}</laneSection></lanes>'
    )
    roads, connections = [], []
    for number, (x, y, heading) in enumerate([(-12, 0, math.pi), (12, 0, 0.0), (0, -12, -math.pi / 2)], 1):
        sides = [lane.format(sign * 2, "sidewalk", "", 2) + lane.format(sign, "driving", "", 3.5) for sign in (1, -1)]
        right = lane.format(-1, "driving", "", 3.5) + lane.format(-2, "sidewalk", "", 2)
        roads.append(
            f'<road id="{number}" length="70" junction="-1">'
            '<link><predecessor elementType="junction" elementId="9"/></link>'
            + plan.format(x, y, heading, 70, "<line/>")
            + section.format(f"<left>{sides[0]}</left>", f"<right>{right}</right>")
            + "</road>"
        )
    turns = [(1, 2, -12, 0, 0.0, 0), (2, 1, 12, 0, math.pi, 0), (1, 3, -12, 0, 0.0, -1), (3, 1, 0, -12, math.pi / 2, 1)]
    turns += [(3, 2, 0, -12, math.pi / 2, -1), (2, 3, 12, 0, math.pi, 1)]
    for number, (start, end, x, y, heading, bend) in enumerate(turns, 10):
        length = 24 if not bend else 6 * math.pi
        shape = "<line/>" if not bend else f'<arc curvature="{bend / 12}"/>'
        link = '<link><predecessor id="1"/><successor id="-1"/></link>'
        roads.append(
            f'<road id="{number}" length="{length}" junction="9"><link><predecessor elementType="road" '
            f'elementId="{start}" contactPoint="start"/><successor elementType="road" elementId="{end}" '
            f'contactPoint="start"/></link>{plan.format(x, y, heading, length, shape)}'
            + section.format("", f"<right>{lane.format(-1, 'driving', link, 3.5)}</right>")
            + "</road>"
        )
        connections.append(
            f'<connection id="{number}" incomingRoad="{start}" connectingRoad="{number}" contactPoint="start">'
            '<laneLink from="1" to="-1"/></connection>'
        )
    junction = f'<junction id="9" name="T">{"".join(connections)}</junction>'
    return f'<OpenDRIVE><header revMajor="1" revMinor="4"/>{"".join(roads)}{junction}</OpenDRIVE>'


def test_opendrive_as_roadrunner_writes_it(tmp_path: Path) -> None:
    file = tmp_path / "t.xodr"
    file.write_text(roadrunner(), "utf-8")
    town = import_town(file, tmp_path / "tee").town
    assert Counter(one.type.value for one in town.approaches.values()) == {
        "STRAIGHT_LEFT": 1, "STRAIGHT_RIGHT": 1, "LEFT_RIGHT": 1,
    }  # fmt: skip
    assert town.sidewalks.area > 400, "sidewalks of the file are kept"
    assert all(lane.width == pytest.approx(3.5, abs=0.02) for lane in town.lanes.values())


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.osm", "", "cannot be read as XML"),
        ("a.osm", "<osm version='0.6'/>", "netconvert rejects it|no road"),
        ("a.osm", "<osm><relation id='1'><tag k='type' v='lanelet'/></relation></osm>", "Lanelet2"),
        ("a.xodr", "<OpenDRIVE/>", "netconvert rejects it|no road"),
        ("a.net.xml", "<net/>", "no road"),
        ("a.net.xml", "<net><edge id='a'/></net>", "no complete SUMO network"),
        ("a.net.xml", "<routes/>", "root element is <routes>"),
        ("a.net.xml.gz", "no gzip", "cannot be read"),
    ],
)
def test_bad_files_are_refused(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text, "utf-8")
    with pytest.raises(ImportTownError, match=said):
        import_town(tmp_path / name, tmp_path / "town")
    assert not (tmp_path / "town").exists(), "nothing is left behind"


@pytest.mark.parametrize("name", ["1st", "drawn-1", "a b", "x" * 41, "training-0"])
def test_names_that_a_town_cannot_have(tmp_path: Path, name: str) -> None:
    with pytest.raises(ImportTownError, match="--name"):
        import_town(VILLAGE, tmp_path / name)
