"""Make the camera's picture in the documentation: a sheet of junction types and weathers.

::

    python -m lab.sheet [DIRECTORY]
"""

import sys
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wrongturn_networks import Approach, Town, load_town
from wrongturn_protocol import JunctionType, Weather
from wrongturn_sim.camera.palette import PALETTE, pose_before
from wrongturn_sim.camera.renderer import Renderer
from wrongturn_sim.camera.world import World

TOWN: Final = "Town01"

Image = NDArray[np.uint8]


def approaches_by_type(town: Town) -> dict[JunctionType, Approach]:
    """Return the first approach of each type of T junction."""
    found: dict[JunctionType, list[Approach]] = {}
    for approach in town.approaches.values():
        if approach.type.missing is not None:
            found.setdefault(approach.type, []).append(approach)
    return {kind: found[kind][0] for kind in sorted(found)}


def sheet(town: Town, scale: int = 2, distance: float = 20.0) -> Image:
    """Return a sheet: a column for each junction type; for each weather, a row of colours and one of classes."""
    world = World.of(town)
    columns = []
    for approach in approaches_by_type(town).values():
        pose = pose_before(approach, distance)
        cells = []
        for weather in Weather:
            rgb, segmentation = Renderer(world, weather=weather, seed=1).render(*pose)
            cells += [rgb, PALETTE[segmentation]]
        columns.append(np.concatenate([np.pad(cell, ((1, 1), (1, 1), (0, 0))) for cell in cells]))
    return np.concatenate(columns, axis=1).repeat(scale, axis=0).repeat(scale, axis=1)


def main(directory: Path) -> None:
    """Write ``sheet.png``."""
    directory.mkdir(parents=True, exist_ok=True)
    town = load_town(TOWN)
    cv2.imwrite(str(directory / "sheet.png"), sheet(town)[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("docs/pictures"))
