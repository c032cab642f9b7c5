"""Colours for the classes of a segmentation, and what pictures for people need."""

import math
from typing import Final

import numpy as np

from wrongturn_networks import Approach

_CODES: Final = "000000 5c5a60 f0ec6e c878cc 408c3c 70463c ce9a6c 283cc8 dc2828 e6c800 5a96e8"
PALETTE: Final = np.frombuffer(bytes.fromhex(_CODES), np.uint8).reshape(-1, 3)
"""(11, 3): red, green and blue of each class, by its number."""


def pose_before(approach: Approach, distance: float) -> tuple[float, float, float]:
    """Return the pose (x, y, yaw) this many metres before an approach's stop line, as if its lane were straight."""
    x, y = approach.stop_line
    return x - distance * math.cos(approach.heading), y - distance * math.sin(approach.heading), approach.heading
