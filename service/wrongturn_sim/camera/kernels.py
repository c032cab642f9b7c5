"""What every kernel is made of: compilation, whole-number noise, pixels.

Kernels are scalar functions of one image column that allocate nothing and keep nothing, so that a GPU can run the same
source. Fast arithmetic is allowed here, where nothing is scored; the instruction set is pinned (see
:mod:`wrongturn_sim.home`), so that the bytes do not hang on the machine.
"""

import math
from collections.abc import Callable
from typing import Any, Final, NamedTuple, TypeVar

import numba

from wrongturn_sim.camera.weathers import HAZE_RATE
from wrongturn_sim.home import set_cache

set_cache()

F = TypeVar("F", bound=Callable[..., Any])


NEAR: Final = 0.25
"""What is nearer than this is not drawn, metres."""
HITS: Final = 48
"""Solids that a column can meet; of more, the nearest are kept."""

# What all pixels of a row have in common.
SLOPES, REACH, UPPER, LOWER, HAZE = range(5)
ROWS: Final = 5

# Rows of a column's work area, each as long as the picture is high (and at least HITS).
DEPTH, SHADE, FIRST, LAST, WHICH = range(5)
WORK: Final = 5


class Scene(NamedTuple):
    """What is looked at."""

    ground: Any
    """See :mod:`~wrongturn_sim.camera.ground`."""
    frame: Any
    """(3,): x and y of its first cell's corner, metres, and cells for each metre."""
    scenery: Any
    """(N, COLUMNS); see :mod:`~wrongturn_sim.camera.solids`."""
    shops: Any
    """(S, 3) colours of shop signs."""
    cover: Any
    """(512, 512) cover of the sky by clouds."""


class Scratch(NamedTuple):
    """What is written on while a picture is painted."""

    rows: Any
    """(ROWS, rows)"""
    work: Any
    """(WORK, rows)"""
    place: Any
    """(N, 2): the camera in the frame of each solid."""
    counts: Any
    """(columns,): how many solids may be seen in each."""
    lists: Any
    """(columns, N): which."""
    users: Any
    """(M, COLUMNS): road users as solids."""
    canvas: Any
    """(rows, columns): red, green, blue and class of each pixel, a byte each."""


OPTIONS: Final[dict[str, Any]] = {
    "fastmath": True,
    "error_model": "numpy",
    "nogil": True,
    # Numba's counting of references would take two thirds of the time, and nothing is allocated.
    "_nrt": False,
}


def kernel(function: F) -> F:
    """Compiled as part of the kernels that call it."""
    compiled: F = numba.njit(**OPTIONS, forceinline=True)(function)
    return compiled


@kernel
def noise(x: int, y: int, seed: int) -> float:
    """0 to 1, of whole numbers."""
    value = (x * 374761393 + y * 668265263 + seed * 2246822519) & 0xFFFFFFFF
    value = ((value ^ (value >> 15)) * 0x2C1B3C6D) & 0xFFFFFFFF
    value = ((value ^ (value >> 12)) * 0x297A2D39) & 0xFFFFFFFF
    return ((value ^ (value >> 15)) & 0xFFFF) * (1.0 / 65535.0)


@kernel
def grain(x: int, y: int, seed: int) -> float:
    """0 to 1, of whole numbers: cheaper than :func:`noise` and good enough for textures."""
    value = (x * 374761393 + y * 668265263 + seed * 2246822519) & 0xFFFFFFFF
    value = (value ^ (value >> 15)) * 0x2C1B3C6D
    return ((value >> 12) & 0xFFFF) * (1.0 / 65535.0)


@kernel
def floor(value: float) -> int:
    """The whole number below; on a GPU, ``math.floor`` gives no whole number."""
    return int(math.floor(value))  # noqa: RUF046


@kernel
def ceil(value: float) -> int:
    """The whole number above; likewise."""
    return int(math.ceil(value))  # noqa: RUF046


@kernel
def clamp(value: float, low: float, high: float) -> float:
    """The nearest number from low to high."""
    return min(max(value, low), high)


@kernel
def put(canvas: Any, u: int, v: int, red: float, green: float, blue: float, seen: int) -> None:
    """Writes a pixel; colours from 0, cut at 255."""
    canvas[v, u] = int(min(red, 255.0)) | int(min(green, 255.0)) << 8 | int(min(blue, 255.0)) << 16 | int(seen) << 24


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
    return ceil(row)


@kernel
def haze_at(t: float, look: Any) -> float:
    """Share of the haze's colour at a distance."""
    x: float = t * look[HAZE_RATE]
    return x * x / (1.0 + x * x)
