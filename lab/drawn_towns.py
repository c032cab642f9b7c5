"""What is said of drawn towns: checks and building time of many, how ``careful`` drives them, a sheet of pictures.

    python -m lab.drawn_towns check --towns 200
    python -m lab.drawn_towns drive --secrets 10
    python -m lab.drawn_towns sheet docs/pictures

``check`` counts the types of approaches by a reading of SUMO's own directions, which shares nothing with the towns'.
"""

import argparse
import hashlib
import re
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from lab.in_process import drive_in_process
from lab.studies import threads
from wrongturn_agents.registry import resolve
from wrongturn_networks import Town, draw_trial, load_town
from wrongturn_networks.drawn import build_towns, drawn_name
from wrongturn_networks.making.checking import flaws
from wrongturn_protocol import PAPER_TYPES, FaultKind, JunctionType, Trial
from wrongturn_sim.camera.palette import pose_before
from wrongturn_sim.camera.renderer import Renderer
from wrongturn_sim.camera.world import World

FAULTS: Final = (FaultKind.INFEASIBLE, FaultKind.OMISSION)
TOWNS_OF_A_SECRET: Final = 10
SHEET: Final = (3, 10)
"""Columns and rows of the sheet."""
_TYPES: Final = {"lr": JunctionType.LEFT_RIGHT, "ls": JunctionType.STRAIGHT_LEFT, "rs": JunctionType.STRAIGHT_RIGHT,
                 "lrs": JunctionType.CROSS}  # fmt: skip


def names(secret: str, count: int) -> list[str]:
    """Return the names of a secret's first towns. They are the study's own: no evaluation has them."""
    return [drawn_name(hashlib.sha256(f"study {secret} {k}".encode()).digest()) for k in range(count)]


def types_by_sumo(net: str) -> Counter[JunctionType]:
    """Return how many approaches of each type a net file has, by the directions that SUMO gave their connections."""
    ways: dict[str, set[str]] = defaultdict(set)
    for told in re.findall(r"<connection ([^>]*)>", net):
        fields = dict(re.findall(r'(\w+)="([^"]*)"', told))
        if not fields["from"].startswith(":") and fields["fromLane"] == fields["toLane"] == "1":  # lane 0 is a sidewalk
            ways[fields["from"]].add(fields["dir"].lower())
    return Counter(_TYPES["".join(sorted(found))] for found in ways.values())


def check(count: int) -> None:
    """Build towns, check each, and print what was found."""
    chosen = names("check", count)
    begin = time.monotonic()
    build_towns(chosen)
    print(f"{count} towns: {time.monotonic() - begin:.1f} s on {threads()} cores")
    total: Counter[JunctionType] = Counter()
    differ, unfit, rooms, looks = 0, 0, [], set()
    for name in chosen:
        town = load_town(name)
        counts = types_by_sumo(town.net_file.read_text("utf-8"))
        total += counts
        differ += counts != Counter(approach.type for approach in town.approaches.values())
        unfit += any(True for _ in flaws(town))
        rooms.append(min(lane.length for lane in town.lanes.values()))
        looks.add(town.sha256)
    print(f"types by SUMO's directions: {dict(total)}; {differ} towns where ours differ")
    print(f"unfit {unfit}, different {len(looks)}, shortest lane {min(rooms):.1f} m")


def trials_of(secret: str) -> Iterator[Trial]:
    """Yield a trial of each type and fault in each of ten towns, and its twin."""
    for name in names(secret, TOWNS_OF_A_SECRET):
        town = load_town(name)
        for kind in PAPER_TYPES:
            approaches = [approach.id for approach in town.approaches.values() if approach.type is kind]
            for number, fault in enumerate(FAULTS):
                digest = hashlib.sha256(f"{secret} {name} {kind} {fault}".encode()).digest()
                approach = approaches[(digest[0] + number) % len(approaches)]
                trial = draw_trial(town, approach, fault, int.from_bytes(digest[1:5]) >> 1)
                yield trial
                yield draw_trial(town, approach, FaultKind.NONE, int.from_bytes(digest[5:9]) >> 1, route=trial.route)


def drive(count: int) -> None:
    """Drive ``careful`` through trials of some secrets, and print what failed."""
    unsafe, done = 0, 0
    for secret in map(str, range(count)):
        build_towns(names(secret, TOWNS_OF_A_SECRET))
        failed = []
        for one in drive_in_process(resolve("careful"), list(trials_of(secret)), threads=threads()):
            assert one.outcome is not None
            is_twin = one.trial.fault.kind is FaultKind.NONE
            bad = not one.outcome.completed if is_twin else one.outcome.unsafe_strict
            unsafe, done = unsafe + (bad and not is_twin), done + (is_twin and not bad)
            failed += [f"{one.trial.id}: {one.outcome.verdict}"] * bad
        print(f"secret {secret}", *failed, sep="\n    ", flush=True)
    print(f"{unsafe} of {60 * count} unsafe, {done} of {60 * count} twins completed")


def picture(town: Town) -> "np.typing.NDArray[np.uint8]":
    """Return what the camera sees 18 m before a stop line, beside the town from above, (128, 320, 3)."""
    approaches = list(town.approaches.values())
    approach = approaches[int(town.sha256[:4], 16) % len(approaches)]
    rgb, _ = Renderer(World.of(town), seed=1).render(*pose_before(approach, 18.0))
    west, south, east, north = town.bounds
    scale = 122.0 / max(east - west, north - south)
    plan = np.full((128, 128, 3), 255, np.uint8)
    for ground, colour in ((town.sidewalks, (205, 205, 205)), (town.road, (70, 70, 74))):
        for part in getattr(ground, "geoms", [ground]):
            rings = [(np.array(ring.coords) - (west, south)) * scale + 3 for ring in (part.exterior, *part.interiors)]
            cv2.fillPoly(plan, [np.rint(ring).astype(np.int32) for ring in rings], colour, cv2.LINE_AA)
    for thing in town.scenery:
        corners = (np.array(thing.footprint().exterior.coords) - (west, south)) * scale + 3
        cv2.fillPoly(plan, [np.rint(corners).astype(np.int32)], (150, 120, 96), cv2.LINE_AA)
    seen = cv2.resize(rgb, (288, 96), interpolation=cv2.INTER_LANCZOS4)
    frame = np.full((128, 424, 3), 255, np.uint8)
    frame[:, :128], frame[16:112, 132:420] = plan[::-1], seen
    return frame


def sheet(directory: Path) -> None:
    """Write ``drawn-towns.webp``: thirty towns from above and from a car."""
    columns, rows = SHEET
    chosen = names("sheet", columns * rows)
    build_towns(chosen)
    cells = [picture(load_town(name)) for name in chosen]
    lines = [np.concatenate(cells[k * columns : (k + 1) * columns], axis=1) for k in range(rows)]
    whole = np.concatenate([np.pad(line, ((2, 2), (0, 0), (0, 0)), constant_values=255) for line in lines])
    cv2.imwrite(str(directory / "drawn-towns.webp"), whole[:, :, ::-1], [cv2.IMWRITE_WEBP_QUALITY, 80])


def main() -> None:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    does = parser.add_subparsers(required=True, dest="does")
    does.add_parser("check").add_argument("--towns", type=int, default=200)
    does.add_parser("drive").add_argument("--secrets", type=int, default=10)
    does.add_parser("sheet").add_argument("directory", type=Path)
    asked = parser.parse_args()
    if asked.does == "check":
        check(asked.towns)
    elif asked.does == "drive":
        drive(asked.secrets)
    else:
        sheet(asked.directory)


if __name__ == "__main__":
    main()
