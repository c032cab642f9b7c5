"""What every kernel is made of: compilation, whole-number noise, pixels.

Kernels are scalar functions of one image column that allocate nothing and keep nothing, so that a GPU can run the same
source. Fast arithmetic is allowed here, where nothing is scored; the instruction set is pinned (see
:mod:`wrongturn_sim.home`), so that the bytes do not hang on the machine.
"""

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numba

from wrongturn_sim.home import set_cache

set_cache()

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compiled as part of the kernels that call it."""
    compiled: F = numba.njit(fastmath=True, error_model="numpy", nogil=True)(function)
    return compiled


@kernel
def noise(x: int, y: int, seed: int) -> float:
    """0 to 1, of whole numbers."""
    value = (x * 374761393 + y * 668265263 + seed * 2246822519) & 0xFFFFFFFF
    value = ((value ^ (value >> 15)) * 0x2C1B3C6D) & 0xFFFFFFFF
    value = ((value ^ (value >> 12)) * 0x297A2D39) & 0xFFFFFFFF
    return ((value ^ (value >> 15)) & 0xFFFF) * (1.0 / 65535.0)


@kernel
def clamp(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@kernel
def put(rgb: Any, segmentation: Any, u: int, v: int, red: float, green: float, blue: float, seen: int) -> None:
    """Writes a pixel; colours 0 to 255 and beyond."""
    rgb[v, u, 0] = int(min(max(red, 0.0), 255.0))
    rgb[v, u, 1] = int(min(max(green, 0.0), 255.0))
    rgb[v, u, 2] = int(min(max(blue, 0.0), 255.0))
    segmentation[v, u] = seen


@kernel
def first_row(limit: float, v0: int, v1: int, focal: float, cy: float, slopes: Any) -> int:
    """The first row of v0 to v1 whose ray rises by no more than the limit for each metre ahead; v1 if none."""
    if v1 - v0 == 1:
        return v0 if slopes[v0] <= limit else v1
    row = cy - focal * limit
    if row <= v0:
        return v0
    if row >= v1:
        return v1
    return int(math.ceil(row))


@kernel
def haze_at(t: float, look: Any) -> float:
    """Share of the haze's colour at a distance."""
    x = t * look[18]
    return x * x / (1.0 + x * x)
