"""Import the networks that ship with SUMO, and the village of the docs: what works, as a table and as maps.

python -m lab.imported --picture docs/pictures/imported.webp
"""

import argparse
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wrongturn_networks import NetworkError, Town
from wrongturn_networks.making.importing import Imported, import_town
from wrongturn_networks.making.netconvert import netconvert
from wrongturn_protocol import JunctionType
from wrongturn_sim.camera import Renderer, World
from wrongturn_sim.camera.palette import pose_before

SIGNS: Final = "--tls.discard-loaded"
ROUND: Final = "--default.junctions.radius=9"
FILES: Final[dict[str, tuple[str, tuple[str, ...]]]] = {
    "berlin": ("tools/game/DRT/osm.net.xml", ()),
    "berlin2": ("tools/game/DRT/osm.net.xml", (ROUND, SIGNS)),
    "braunschweig": ("tools/game/bs3d/bs.net.xml", ()),
    "braunschweig2": ("tools/game/bs3d/bs.net.xml", (ROUND, SIGNS)),
    "exit": ("tools/game/A10KW/osm.net.xml", ()),
    "square": ("tools/game/square/square.net.xml", ()),
    "square2": ("tools/game/square/square.net.xml", (SIGNS,)),
    "cross": ("tools/game/cross/cross.net.xml", (SIGNS,)),
    "grid": ("tools/game/grid6/grid6.net.xml", (SIGNS,)),
    "ingolstadt": ("tools/game/fkk_in/ingolstadt.net.xml.gz", ()),
    "highway": ("tools/game/highway/highway.net.xml", ()),
    "rail": ("tools/game/rail/net.net.xml", ()),
    "ring": ("tools/game/racing/spreewaldring.osm", ()),
}
VILLAGE: Final = Path(__file__).parents[1] / "docs" / "examples" / "village.osm"
SHOWN: Final = ("village", "braunschweig2", "berlin2", "exit")
_SIZE: Final = 480
_COLOURS: Final = dict(zip(JunctionType, ((178, 114, 0), (0, 94, 213), (115, 158, 0), (167, 121, 204)), strict=True))


def imported(folder: Path) -> Iterator[tuple[str, Path, tuple[str, ...], Imported | str]]:
    """Yield name, file, options of netconvert and the town, or why there is none, of each file."""
    sumo = netconvert().parent.parent
    for name, (file, options) in {"village": (str(VILLAGE), ()), **FILES}.items():
        try:
            yield name, sumo / file, options, import_town(sumo / file, folder / name, options=options)
        except NetworkError as error:
            yield name, sumo / file, options, str(error).rpartition(f"{name}: ")[2].rpartition("xml: ")[2]


def row(file: Path, options: tuple[str, ...], found: Imported | str) -> str:
    """Return a row of the table, in Markdown."""
    head = f"| `{'/'.join(file.parts[-2:])}` {' '.join(f'`{one}`' for one in options)}"
    if isinstance(found, str):
        return f"{head} | none: {found} | | |"
    counts = Counter(approach.type for approach in found.town.approaches.values())
    reasons = Counter(_sort(reason) for reason in found.left_out.values())
    kinds = ", ".join(f"{count} {reason}" for reason, count in reasons.most_common())
    return (
        f"{head} | {len(found.town.junctions)} | {' / '.join(str(counts[kind]) for kind in JunctionType)} | {kinds} |"
    )


def _sort(reason: str) -> str:
    words = ("signals", "roundabout", "railway", "exits", "angles", "radius", "room", "levels")
    return next((word for word in words if f"{word}: " in reason), "more than four arms")


def picture(town: Town) -> NDArray[np.uint8]:
    """Return the map of a town above a view of its camera, (height, width, 3), BGR."""
    west, south, east, north = town.bounds
    scale = (_SIZE - 20) / max(east - west, north - south)
    sheet = np.full((_SIZE, _SIZE, 3), 255, np.uint8)

    def pixels(points: object) -> NDArray[np.int32]:
        xy = np.asarray(points, np.float64)[..., :2]
        return np.rint((xy - (west, north)) * (scale, -scale) * 16 + 160).astype(np.int32)

    for part in getattr(town.road, "geoms", [town.road]):
        rings = [pixels(ring.coords) for ring in (part.exterior, *part.interiors)]
        cv2.fillPoly(sheet, rings, (170, 170, 170), cv2.LINE_AA, 4)
    for approach in town.approaches.values():
        place = [int(one) for one in pixels(approach.stop_line)]
        cv2.circle(sheet, place, 64, _COLOURS[approach.type], -1, cv2.LINE_AA, 4)
    first = max(town.approaches.values(), key=lambda one: town.lanes[one.lane].length)
    seen, _ = Renderer(World.of(town), weather="ClearNoon", seed=1).render(*pose_before(first, 18.0))
    view = cv2.resize(seen[:, :, ::-1], (_SIZE, _SIZE // 3), interpolation=cv2.INTER_NEAREST)
    return np.concatenate([sheet, view.astype(np.uint8)])


def main() -> None:
    """Run the program."""
    parser = argparse.ArgumentParser(prog="python -m lab.imported", description=__doc__)
    parser.add_argument("--picture", type=Path, help="write the maps here")
    file = parser.parse_args().picture
    shown = []
    with tempfile.TemporaryDirectory() as folder:
        for name, path, options, found in imported(Path(folder)):
            print(row(path, options, found), flush=True)
            if name in SHOWN and not isinstance(found, str):
                shown.append(picture(found.town))
    if file is not None:
        cv2.imwrite(str(file), np.concatenate(shown, 1), [cv2.IMWRITE_WEBP_QUALITY, 80])


if __name__ == "__main__":
    main()
