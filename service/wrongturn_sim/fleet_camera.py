"""The pictures of a fleet: one batch for each decision."""

from collections.abc import Sequence

import numpy as np

from wrongturn_protocol import Track, Weather
from wrongturn_protocol.observations import Observation
from wrongturn_sim.camera import Camera, World, look_of, render_batch
from wrongturn_sim.fleet import Fleet


class FleetCamera:
    """Paints what each ego of a fleet sees.

    Args:
        fleet: whose egos.
        camera: of all of them.
        track: ``camera`` or ``segmentation``.
        threads: how many share the work; no byte hangs on it.
    """

    def __init__(self, fleet: Fleet, camera: Camera, track: Track, threads: int) -> None:
        self._fleet = fleet
        self._camera = camera
        self._threads = threads
        self._world = World.of(fleet.town)
        shape = (fleet.count, camera.height, camera.width)
        self._rgb = np.zeros((*shape, 3), np.uint8)
        self._segmentation = np.zeros(shape, np.uint8)
        self._looks = {weather: look_of(weather) for weather in Weather}
        self.pictures: Observation = {"rgb": self._rgb}
        """(n, height, width, 3) and, in the segmentation track, (n, height, width); the next pictures overwrite it."""
        if track is Track.SEGMENTATION:
            self.pictures["segmentation"] = self._segmentation

    def paint(self, which: Sequence[int] | None = None) -> None:
        """Paint anew what all egos see, or only these; each has begun a trial."""
        fleet = self._fleet
        chosen = list(range(fleet.count)) if which is None else list(which)
        trials = [trial for trial in (fleet.trials[i] for i in chosen) if trial is not None]
        looks = np.array([self._looks[trial.weather] for trial in trials])
        seeds = np.array([trial.seed for trial in trials], np.int64)
        poses, ticks = fleet.poses[chosen], fleet.steps[chosen]
        whole = len(chosen) == fleet.count
        rgb = self._rgb if whole else np.empty((len(chosen), *self._rgb.shape[1:]), np.uint8)
        segmentation = self._segmentation if whole else np.empty((len(chosen), *rgb.shape[1:3]), np.uint8)
        render_batch(self._world, self._camera, looks, seeds, poses, ticks, rgb, segmentation, threads=self._threads)
        if not whole:
            self._rgb[chosen] = rgb
            self._segmentation[chosen] = segmentation
