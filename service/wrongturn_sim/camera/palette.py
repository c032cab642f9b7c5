"""Colours for the classes of a segmentation, and what pictures for people need."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_networks import Approach

PALETTE: Final[NDArray[np.uint8]] = np.array(
    [
        (0, 0, 0),
        (92, 90, 96),
        (240, 236, 110),
        (200, 120, 204),
        (64, 140, 60),
        (112, 70, 60),
        (206, 154, 108),
        (40, 60, 200),
        (220, 40, 40),
        (230, 200, 0),
        (90, 150, 232),
    ],
    np.uint8,
)
"""(11, 3): red, green and blue of each class, by its number."""


def coloured(segmentation: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a segmentation (h, w) as a picture (h, w, 3)."""
    return PALETTE[segmentation]


def larger(image: NDArray[np.uint8], times: int) -> NDArray[np.uint8]:
    """Return an image whose pixels are squares with sides of this many pixels."""
    return image.repeat(times, axis=0).repeat(times, axis=1)


def pose_before(approach: Approach, distance: float) -> tuple[float, float, float]:
    """Return the pose (x, y, yaw) this many metres before an approach's stop line, as if its lane were straight."""
    x, y = approach.stop_line
    return x - distance * math.cos(approach.heading), y - distance * math.sin(approach.heading), approach.heading
