"""The camera's mounting and optics."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from wrongturn_sim.errors import CameraError

LARGEST_SIDE = 2048
"""Most columns or rows of a picture."""

# Positions in the array that `Camera.packed` returns and the kernels read. Plain integers, so that numba freezes them.
FOCAL, CX, CY, FORWARD, LEFT, UP, PITCH_COS, PITCH_SIN, CAMERA_YAW = range(9)
LEVEL = 9
"""1 where the pitch is exactly 0, else 0."""


@dataclass(frozen=True)
class Camera:
    """A pinhole camera on the car, by OpenCV's conventions. The defaults are the benchmark's.

    The pixel in column u and row v looks along the ray through its middle: for each metre ahead, this goes
    ``(u - cx) / focal`` metres to the right and ``(v - cy) / focal`` metres down. Columns count from the left and rows
    from the top, both from 0. There is no roll and no distortion. Raises CameraError, which names the parameter.
    """

    width: int = 192
    """Columns, pixels."""
    height: int = 64
    """Rows, pixels."""
    focal: float = 107.4
    """Focal length in both directions, pixels."""
    cx: float = 96.0
    """Column of the optical axis."""
    cy: float = 26.0
    """Row of the optical axis. With pitch 0 this is the horizon's row."""
    forward: float = 0.7
    """Metres in front of the middle of the car's body."""
    left: float = 0.0
    """Metres to the left of the middle of the car's body."""
    up: float = 1.6
    """Metres above the ground."""
    pitch: float = 0.0
    """Radians; a positive pitch looks down."""
    yaw: float = 0.0
    """Radians; a positive yaw looks to the left."""

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            side = getattr(self, name)
            if isinstance(side, bool) or not isinstance(side, int | np.integer) or not 1 <= side <= LARGEST_SIDE:
                raise CameraError(f"camera: {name} is {side!r}; give a whole number of pixels, 1 to {LARGEST_SIDE}")
        for name, least, most in (
            ("focal", 1.0, 1e5),
            ("cx", -1e5, 1e5),
            ("cy", -1e5, 1e5),
            ("forward", -20.0, 20.0),
            ("left", -20.0, 20.0),
            ("up", 0.05, 100.0),
            ("pitch", -1.5, 1.5),
            ("yaw", -2 * math.pi, 2 * math.pi),
        ):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float | np.floating | np.integer):
                raise CameraError(f"camera: {name} is {value!r}; give a number from {least:g} to {most:g}")
            if not least <= value <= most:
                raise CameraError(f"camera: {name} is {value!r}; give a finite number from {least:g} to {most:g}")

    @classmethod
    def of_fov(cls, fov_degrees: float, width: int = 192, height: int = 64, **mounting: Any) -> Self:
        """Return a camera with a horizontal field of view of 1 to 170 degrees, whose axis goes through the middle.

        ``mounting`` are ``forward``, ``left``, ``up``, ``pitch`` and ``yaw``, as the fields of these names. Raises
        CameraError for a parameter that is out of its range.
        """
        right = isinstance(fov_degrees, int | float | np.floating) and not isinstance(fov_degrees, bool)
        if not right or not 1.0 <= fov_degrees <= 170.0:
            raise CameraError(f"camera: fov_degrees is {fov_degrees!r}; give a number from 1 to 170")
        # Check the sides before the focal length is computed from them.
        plain = cls(width, height)
        focal = width / 2 / math.tan(math.radians(fov_degrees) / 2)
        return replace(plain, focal=focal, cx=width / 2, cy=height / 2, **mounting)

    def project(self, points: NDArray[np.float64], x: float, y: float, yaw: float) -> NDArray[np.float64]:
        """Return the pixels at which a car at (x, y, yaw) sees points of the town (N, 3): metres, z above the ground.

        Returns:
            (N, 2): column and row; NaN for points that are not in front of the camera.

        Raises:
            CameraError: the points have another shape.
        """
        points = np.asarray(points, np.float64)
        if points.ndim != 2 or points.shape[1] != 3:
            raise CameraError(f"project: points have the shape {points.shape}; give (N, 3)")
        cos, sin = math.cos(yaw), math.sin(yaw)
        eye = (x + self.forward * cos - self.left * sin, y + self.forward * sin + self.left * cos, self.up)
        look, tilt = yaw + self.yaw, self.pitch
        ahead = (math.cos(tilt) * math.cos(look), math.cos(tilt) * math.sin(look), -math.sin(tilt))
        right = (math.sin(look), -math.cos(look), 0.0)
        down = (-math.sin(tilt) * math.cos(look), -math.sin(tilt) * math.sin(look), -math.cos(tilt))
        z, u, v = ((points - eye) @ np.array(axis) for axis in (ahead, right, down))
        depth = np.where(z > 1e-9, z, np.nan)
        return np.stack([self.cx + self.focal * u / depth, self.cy + self.focal * v / depth], axis=1)

    def packed(self) -> NDArray[np.float64]:
        """Return the parameters as the array that the kernels read."""
        tilt = self.pitch
        packed = np.zeros(LEVEL + 1)
        packed[[FOCAL, CX, CY]] = self.focal, self.cx, self.cy
        packed[[FORWARD, LEFT, UP]] = self.forward, self.left, self.up
        packed[[PITCH_COS, PITCH_SIN]] = math.cos(tilt), math.sin(tilt)
        packed[[CAMERA_YAW, LEVEL]] = self.yaw, tilt == 0.0
        return packed


def one_size(cameras: Sequence[Camera], count: int) -> Camera:
    """Return the first of several cameras. Raises CameraError if there are not ``count`` or their sizes differ."""
    if len(cameras) != count or len({(one.width, one.height) for one in cameras}) != 1:
        raise CameraError(f"camera: there are {len(cameras)}; give one for all, or {count} with pictures of one size")
    return cameras[0]
