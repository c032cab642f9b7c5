"""Makes the pictures of the docs: a sheet of junction types and weathers, and a film of a drive.

::

    python -m wrongturn_sim.camera.sheet [DIRECTORY]
"""

import math
import sys
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wrongturn_networks import Approach, Town, load_town
from wrongturn_protocol import JunctionType, Weather
from wrongturn_sim.camera.palette import coloured, larger, pose_before
from wrongturn_sim.camera.renderer import Renderer
from wrongturn_sim.camera.world import World

TOWN: Final = "Town01"
SPEED: Final = 0.7
"""Metres for each picture of the film: of a tenth of a second."""

Image = NDArray[np.uint8]


def approaches_by_type(town: Town) -> dict[JunctionType, Approach]:
    """The first approach of each T type."""
    found: dict[JunctionType, list[Approach]] = {}
    for approach in town.approaches.values():
        if approach.type.missing is not None:
            found.setdefault(approach.type, []).append(approach)
    return {kind: found[kind][0] for kind in sorted(found)}


def sheet(town: Town, scale: int = 2, distance: float = 20.0) -> Image:
    """Types by columns; for each weather a row in colours; the classes, which no weather changes, below."""
    world = World.of(town)
    columns = []
    for approach in approaches_by_type(town).values():
        pose = pose_before(approach, distance)
        cells = []
        for weather in Weather:
            rgb, segmentation = Renderer(world, weather=weather, seed=1).render(*pose)
            cells += [rgb, coloured(segmentation)]
        columns.append(np.concatenate([np.pad(cell, ((1, 1), (1, 1), (0, 0))) for cell in cells]))
    return larger(np.concatenate(columns, axis=1), scale)


def drive(town: Town, approach: Approach) -> NDArray[np.float64]:
    """(N, 3) poses along the approach, through the junction and away."""
    way = next(iter(approach.exits.values()))
    points = np.concatenate([town.lanes[approach.lane].centreline, way.path[1:-1], town.lanes[way.lane].centreline])
    points = points[np.concatenate([[True], np.abs(np.diff(points, axis=0)).sum(axis=1) > 1e-6])]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    stop = town.lanes[approach.lane].length
    at = np.arange(stop - 40.0, min(stop + 45.0, along[-1] - 3.0), SPEED)

    def place(distance: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([np.interp(distance, along, points[:, axis]) for axis in (0, 1)], axis=1)

    here, ahead = place(at - 1.4), place(at + 1.4)
    headings = np.unwrap(np.arctan2(*(ahead - here).T[::-1]))
    return np.column_stack([(here + ahead) / 2, headings])


def film(town: Town, approach: Approach, weather: Weather, scale: int = 2) -> list[Image]:
    """Pictures of a drive with a car ahead and people on the sidewalk, colours above classes."""
    renderer = Renderer(World.of(town), weather=weather, seed=1)
    x, y = approach.stop_line
    cos, sin = math.cos(approach.heading), math.sin(approach.heading)
    frames = []
    for tick, pose in enumerate(drive(town, approach)):
        step = 0.13 * tick
        others = np.array(
            [
                # Towards the camera in the other lane, and two who walk.
                [
                    x + (6 - 4 * step) * cos - 4 * sin,
                    y + (6 - 4 * step) * sin + 4 * cos,
                    approach.heading + math.pi,
                    4.5,
                    1.8,
                    1.5,
                    0,
                    5,
                ],
                [
                    x + (step - 26) * cos + 3.4 * sin,
                    y + (step - 26) * sin - 3.4 * cos,
                    approach.heading,
                    0.5,
                    0.5,
                    1.75,
                    1,
                    2,
                ],
                [
                    x - (step + 12) * cos - 7.3 * sin,
                    y - (step + 12) * sin + 7.3 * cos,
                    approach.heading,
                    0.5,
                    0.5,
                    1.68,
                    1,
                    4,
                ],
            ]
        )
        rgb, segmentation = renderer.render(float(pose[0]), float(pose[1]), float(pose[2]), tick, others)
        frames.append(larger(np.concatenate([rgb, coloured(segmentation)]), scale))
    return frames


def main(directory: Path) -> None:
    """Writes ``sheet.png`` and ``film.webp``."""
    directory.mkdir(parents=True, exist_ok=True)
    town = load_town(TOWN)
    cv2.imwrite(str(directory / "sheet.png"), sheet(town)[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    approach = approaches_by_type(town)[JunctionType.LEFT_RIGHT]
    frames = film(town, approach, Weather.CLEAR_NOON)
    animation = cv2.Animation()
    animation.frames = [np.ascontiguousarray(frame[:, :, ::-1]) for frame in frames]
    animation.durations = [100] * len(frames)
    cv2.imwriteanimation(str(directory / "film.webp"), animation, [cv2.IMWRITE_WEBP_QUALITY, 55])


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("docs/pictures"))
