"""The cameras of a rig: what an agent with cameras of its own sees."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wrongturn_protocol import Rig, RigCamera
from wrongturn_protocol.observations import Observation, picture_of
from wrongturn_sim.camera import Camera, Renderer

Image = NDArray[np.uint8]


def camera_of(camera: RigCamera) -> Camera:
    """Return a rig's camera as the renderer takes it."""
    found = Camera.of_fov(
        camera.fov,
        camera.width,
        camera.height,
        forward=camera.forward,
        left=camera.left,
        up=camera.up,
        pitch=math.radians(camera.pitch),
        yaw=math.radians(camera.yaw),
    )
    return found if camera.horizon is None else replace(found, cy=camera.horizon)


class Eyes:
    """The cameras of one episode, with their histories.

    Args:
        rig: what the agent declares.
        renderer: makes the renderer of a camera.
        compressed: whether pictures that are sent as JPEGs stay JPEGs.
    """

    def __init__(self, rig: Rig, renderer: Callable[[Camera], Renderer], *, compressed: bool = False) -> None:
        self._rig = rig
        self._renderers = [renderer(camera_of(camera)) for camera in rig.cameras]
        self._compressed = compressed
        self._kept: list[deque[Any]] = []
        self.forget()

    def forget(self) -> None:
        """Begin an episode: no picture was taken."""
        self._kept = [deque(maxlen=(one.history - 1) * one.stride + 1) for one in self._rig.cameras]

    def look(
        self,
        pose: tuple[float, float, float],
        decision: int,
        others: NDArray[np.float64],
        developed: Callable[[Observation, int], Observation],
    ) -> dict[str, Any]:
        """Return the pictures at a decision, by the names of their cameras. Call it once for each, in order.

        Args:
            pose: x, y, yaw of the car, metres and radians.
            decision: its number, from 0.
            others: other road users, as for :meth:`~wrongturn_sim.camera.Renderer.render`.
            developed: what a disturbance makes of new pictures.
        """
        new = {}
        for camera, renderer in zip(self._rig.cameras, self._renderers, strict=True):
            if decision % (self._rig.rate // (camera.rate or self._rig.rate)) == 0:
                new[camera.name] = renderer.render(*pose, decision, others)[camera.kind != "rgb"]
        new = developed(new, decision)
        return {
            camera.name: self._shown(camera, kept, new.get(camera.name))
            for camera, kept in zip(self._rig.cameras, self._kept, strict=True)
        }

    def _shown(self, camera: RigCamera, kept: deque[Any], picture: Image | None) -> Any:
        """Return the array of a camera; JPEGs as a list, if they stay so."""
        if picture is None:
            kept.append(kept[-1])
        elif camera.jpeg is None:
            kept.append(picture)
        else:
            _, jpeg = cv2.imencode(".jpg", picture[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, camera.jpeg])
            kept.append(jpeg.tobytes() if self._compressed else picture_of(jpeg.tobytes()))
        # Before the first picture there was none: the first stands for it.
        shown = [kept[max(len(kept) - 1 - back * camera.stride, 0)] for back in reversed(range(camera.history))]
        if self._compressed and camera.jpeg is not None:
            return shown
        return shown[0].copy() if camera.history == 1 else np.stack(shown)
