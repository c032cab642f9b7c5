"""Building blocks of all kernels: compilation, noise from whole numbers, and pixels.

A kernel works on one column of a picture with plain numbers. It allocates nothing and keeps no state, so that a GPU
can run the same source. Kernels may use fast arithmetic, because no score depends on a picture's rounding.
:mod:`wrongturn_judge.home` pins the instruction set, so that a picture's bytes do not depend on the machine.
"""

import math
from collections.abc import Callable
from typing import Any, Final, NamedTuple, TypeVar

import numba

from wrongturn_judge.home import set_cache
from wrongturn_sim.camera.pinhole import CAMERA_YAW, FORWARD, LEFT
from wrongturn_sim.camera.solids import COS, SIN
from wrongturn_sim.camera.weathers import HAZE_COLOUR, HAZE_RATE, SKYLIGHT, SUNLIGHT

set_cache()

F = TypeVar("F", bound=Callable[..., Any])

Colour = tuple[float, float, float]
"""Red, green and blue, from 0; pixels cut them at 255."""

NEAR: Final = 0.25
"""Solids nearer than this are not drawn, metres."""
HITS: Final = 48
"""Most solids that a column can meet; of more, the nearest are kept."""

# Rows of the array of what all pixels of a picture's row have in common.
SLOPES, REACH, UPPER, LOWER, HAZE = range(5)
ROWS: Final = 5

# Rows of a column's work area, each as long as the picture is high (and at least HITS).
DEPTH, SHADE, FIRST, LAST, WHICH = range(5)
WORK: Final = 5


class Scene(NamedTuple):
    """What the camera looks at."""

    ground: Any
    """See :mod:`~wrongturn_sim.camera.ground`."""
    frame: Any
    """(3,): x and y of the corner of the ground's first cell, metres, and the number of cells in a metre."""
    scenery: Any
    """(N, COLUMNS); see :mod:`~wrongturn_sim.camera.solids`."""
    shops: Any
    """(S, 3): colours of shop signs."""
    cover: Any
    """(512, 512): cover of the sky by clouds."""


class Scratch(NamedTuple):
    """Arrays that kernels write to while they paint a picture."""

    rows: Any
    """(ROWS, rows)"""
    work: Any
    """(WORK, rows)"""
    place: Any
    """(N, 2): the camera's place in the frame of each solid."""
    counts: Any
    """(columns,): number of solids that may be seen in each column."""
    lists: Any
    """(columns, N): which solids these are."""
    users: Any
    """(M, COLUMNS): road users as solids."""
    canvas: Any
    """(rows, columns): red, green, blue and class of each pixel, one byte each."""


class Eye(NamedTuple):
    """The camera's place on the flat and the unit vector that it looks along there."""

    x: float
    y: float
    ahead_x: float
    ahead_y: float


class Column(NamedTuple):
    """Rows v0 to v1 of column u, which are painted together: all their rays lie in one upright plane."""

    u: int
    v0: int
    v1: int
    px: float
    """The camera's place, metres, town frame."""
    py: float
    dx: float
    """How far the rays go on the flat for each metre of depth, town frame."""
    dy: float
    ex: float
    """What (dx, dy) gains a third of a column to the right."""
    ey: float
    eye: float
    """Height of the camera above the ground, metres."""
    focal: float
    cy: float
    look: Any
    """The weather, as :func:`~wrongturn_sim.camera.weathers.look_of` packs it."""
    slopes: Any
    """(rows,): how far each row's ray rises for each metre of depth."""
    depth: Any
    """(rows,): depth of what is painted so far, metres."""
    shade: Any
    """(rows,): share of the light that reaches the ground past road users."""
    canvas: Any


OPTIONS: Final[dict[str, Any]] = {
    "fastmath": True,
    "error_model": "numpy",
    "nogil": True,
    # Without it, numba's reference counts would take two thirds of the time. Kernels allocate nothing to be counted.
    "_nrt": False,
}


def kernel(function: F) -> F:
    """Compile a function as part of the kernels that call it."""
    compiled: F = numba.njit(**OPTIONS, forceinline=True)(function)
    return compiled


@kernel
def noise(x: int, y: int, seed: int) -> float:
    """Return a number from 0 to 1 that depends on these whole numbers alone."""
    value = (x * 374761393 + y * 668265263 + seed * 2246822519) & 0xFFFFFFFF
    value = ((value ^ (value >> 15)) * 0x2C1B3C6D) & 0xFFFFFFFF
    value = ((value ^ (value >> 12)) * 0x297A2D39) & 0xFFFFFFFF
    return ((value ^ (value >> 15)) & 0xFFFF) * (1.0 / 65535.0)


@kernel
def grain(x: int, y: int, seed: int) -> float:
    """Return a number as :func:`noise` does, at less cost; good enough for textures."""
    value = (x * 374761393 + y * 668265263 + seed * 2246822519) & 0xFFFFFFFF
    value = (value ^ (value >> 15)) * 0x2C1B3C6D
    return ((value >> 12) & 0xFFFF) * (1.0 / 65535.0)


@kernel
def floor(value: float) -> int:
    """Return the whole number below; on a GPU, ``math.floor`` returns a float."""
    return int(math.floor(value))  # noqa: RUF046


@kernel
def ceil(value: float) -> int:
    """Return the whole number above; on a GPU, ``math.ceil`` returns a float."""
    return int(math.ceil(value))  # noqa: RUF046


@kernel
def clamp(value: float, low: float, high: float) -> float:
    """Return the nearest number from low to high."""
    return min(max(value, low), high)


@kernel
def triple(row: Any, first: int) -> Colour:
    """Return three numbers of a look or a solid that belong together, from position ``first`` on."""
    return row[first], row[first + 1], row[first + 2]


@kernel
def mix(colour: Colour, other: Colour, share: float) -> Colour:
    """Return a colour with this share of another one."""
    return (
        colour[0] + (other[0] - colour[0]) * share,
        colour[1] + (other[1] - colour[1]) * share,
        colour[2] + (other[2] - colour[2]) * share,
    )


@kernel
def toned(colour: Colour, tone: float) -> Colour:
    """Return a colour that is this much brighter."""
    return colour[0] * tone, colour[1] * tone, colour[2] * tone


@kernel
def put(column: Column, v: int, colour: Colour, seen: int) -> None:
    """Write a pixel's colour and class."""
    red, green, blue = colour
    code = int(min(red, 255.0)) | int(min(green, 255.0)) << 8 | int(min(blue, 255.0)) << 16 | int(seen) << 24
    column.canvas[v, column.u] = code


@kernel
def put_hazed(column: Column, v: int, colour: Colour, haze: float, seen: int) -> None:
    """Write a pixel whose colour is faded by haze."""
    clear, far = 1.0 - haze, triple(column.look, HAZE_COLOUR)
    red, green, blue = colour
    put(column, v, (red * clear + far[0] * haze, green * clear + far[1] * haze, blue * clear + far[2] * haze), seen)


@kernel
def put_lit(column: Column, v: int, colour: Colour, sun: float, haze: float, seen: int) -> None:
    """Write a pixel of a surface: lit by the sky and by this share of the sun, then faded by haze."""
    sky, direct = triple(column.look, SKYLIGHT), triple(column.look, SUNLIGHT)
    red, green, blue = colour
    lit = red * (sky[0] + sun * direct[0]), green * (sky[1] + sun * direct[1]), blue * (sky[2] + sun * direct[2])
    put_hazed(column, v, lit, haze, seen)


@kernel
def put_toned(column: Column, v: int, row: Any, first: int, tone: float, sun: float, haze: float, seen: int) -> None:
    """Write a pixel of a solid's surface whose colour, from position ``first`` of its row on, is this much brighter."""
    put_lit(column, v, toned(triple(row, first), tone), sun, haze, seen)


@kernel
def first_row(limit: float, column: Column) -> int:
    """Return the first row whose ray rises by no more than the limit for each metre of depth; v1 if there is none."""
    v0, v1 = column.v0, column.v1
    if v1 - v0 == 1:
        return v0 if column.slopes[v0] <= limit else v1
    row = column.cy - column.focal * limit
    if row <= v0:
        return v0
    if row >= v1:
        return v1
    return ceil(row)


@kernel
def haze_at(t: float, look: Any) -> float:
    """Return the haze's share of the colour at a distance."""
    x: float = t * look[HAZE_RATE]
    return x * x / (1.0 + x * x)


@kernel
def eye_of(x: float, y: float, yaw: float, camera: Any) -> Eye:
    """Return where the camera of a car at (x, y, yaw) stands and which way it looks."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    px = x + camera[FORWARD] * cos - camera[LEFT] * sin
    py = y + camera[FORWARD] * sin + camera[LEFT] * cos
    return Eye(px, py, math.cos(yaw + camera[CAMERA_YAW]), math.sin(yaw + camera[CAMERA_YAW]))


@kernel
def turned(row: Any, x: float, y: float) -> tuple[float, float]:
    """Return a direction of the town frame in a solid's own frame."""
    return row[COS] * x + row[SIN] * y, row[COS] * y - row[SIN] * x
