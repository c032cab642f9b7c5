"""Make the pictures of the documentation: a sheet of junction types and weathers, and a film of an episode.

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

from wrongturn_networks import Approach, Town, draw_trial, load_town
from wrongturn_protocol import FaultKind, JunctionType, Track, Traffic, Weather
from wrongturn_sim.camera.palette import coloured, larger, pose_before
from wrongturn_sim.camera.renderer import Renderer
from wrongturn_sim.camera.world import World
from wrongturn_sim.ego import VEHICLE
from wrongturn_sim.episode import Episode

TOWN: Final = "Town01"
FILM_SEED: Final = 4
"""Seed of the film's trial, which decides its start and its traffic."""
SPEED: Final = 6.0
"""Speed of the film's car, m/s."""
LOOK_AHEAD: Final = 5.0
"""Distance of the point that the film's driver steers to, metres."""

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
            cells += [rgb, coloured(segmentation)]
        columns.append(np.concatenate([np.pad(cell, ((1, 1), (1, 1), (0, 0))) for cell in cells]))
    return larger(np.concatenate(columns, axis=1), scale)


def film(town: Town, approach: Approach, scale: int = 2) -> list[Image]:
    """Return the pictures of one episode among other road users, to its verdict, colours above classes."""
    way = next(iter(approach.exits.values()))
    traffic = Traffic(vehicles=30, pedestrians=40)
    trial = draw_trial(town, approach.id, FaultKind.NONE, FILM_SEED, route=way.direction, traffic=traffic)
    route = np.concatenate([town.lanes[approach.lane].centreline, way.path, town.lanes[way.lane].centreline])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(route, axis=0).T))])
    each = np.arange(0.0, along[-1], 0.5)
    route = np.stack([np.interp(each, along, route[:, axis]) for axis in (0, 1)], axis=1)
    episode = Episode(trial, Track.SEGMENTATION)
    seen = episode.reset()
    frames = []
    while True:
        frames.append(larger(np.concatenate([seen["rgb"], coloured(seen["segmentation"])]), scale))
        if episode.outcome is not None:
            return frames
        row = episode.trajectory.rows[-1]
        throttle = 0.5 if row.v < SPEED else 0.0
        seen = episode.step(_towards(route, row.x, row.y, row.yaw), throttle, 0.0).observation


def _towards(route: NDArray[np.float64], x: float, y: float, yaw: float) -> float:
    """Return the steering, right positive, towards a point of the route some metres ahead (pure pursuit)."""
    here = int(np.argmin((route[:, 0] - x) ** 2 + (route[:, 1] - y) ** 2))
    far = np.sqrt((route[here:, 0] - x) ** 2 + (route[here:, 1] - y) ** 2) >= LOOK_AHEAD
    goal_x, goal_y = route[here + int(np.argmax(far))]
    off = math.atan2(goal_y - y, goal_x - x) - yaw
    wheel = math.atan(2 * VEHICLE.wheelbase * math.sin(off) / LOOK_AHEAD)
    return max(-1.0, min(1.0, -wheel / VEHICLE.max_wheel_angle))


def main(directory: Path) -> None:
    """Write ``sheet.png`` and ``film.webp``."""
    directory.mkdir(parents=True, exist_ok=True)
    town = load_town(TOWN)
    cv2.imwrite(str(directory / "sheet.png"), sheet(town)[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    approach = approaches_by_type(town)[JunctionType.LEFT_RIGHT]
    frames = film(town, approach)
    animation = cv2.Animation()
    animation.frames = [np.ascontiguousarray(frame[:, :, ::-1]) for frame in frames]
    animation.durations = [100] * len(frames)
    cv2.imwriteanimation(str(directory / "film.webp"), animation, [cv2.IMWRITE_WEBP_QUALITY, 55])


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("docs/pictures"))
