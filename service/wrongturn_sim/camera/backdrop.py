"""Sky and ground: what is behind and below everything else."""

import math
from typing import Any

import numpy as np

from wrongturn_protocol.segmentation import SegmentationClass
from wrongturn_sim.camera.kernels import (
    HAZE,
    LOWER,
    REACH,
    SLOPES,
    UPPER,
    Colour,
    Column,
    Scene,
    clamp,
    floor,
    haze_at,
    kernel,
    noise,
    put,
    triple,
)
from wrongturn_sim.camera.pinhole import CY, FOCAL, LEVEL, PITCH_COS, PITCH_SIN, UP
from wrongturn_sim.camera.weathers import (
    CLOUD,
    CLOUDS,
    GLOW,
    GROUND_COLOURS,
    HAZE_COLOUR,
    HORIZON,
    SUN,
    WETNESS,
    ZENITH,
)

_SKY = int(SegmentationClass.SKY)
_VEGETATION = int(SegmentationClass.VEGETATION)
_SIDEWALK = int(SegmentationClass.SIDEWALK)
_UNSIGNED = (1 << 63) - 1
_LEVEL_RAY = -1e-4
"""Rays that rise more than this, for each metre of depth, show the sky."""


@kernel
def sky_colour(column: Column, flat: float, slope: float, cover: Any) -> Colour:
    """Return the colour of the sky along a ray.

    ``flat`` is the length of (dx, dy); ``slope`` is how far the ray rises for each metre of depth.
    """
    look, dx, dy = column.look, column.dx, column.dy
    rise = max(slope, 0.0)
    share = rise / (rise + 0.16 * flat)
    red, green, blue = triple(look, HORIZON)
    zenith_r, zenith_g, zenith_b = triple(look, ZENITH)
    red, green, blue = (
        red + (zenith_r - red) * share,
        green + (zenith_g - green) * share,
        blue + (zenith_b - blue) * share,
    )
    # Clouds lie on a plane far above. Towards the horizon they become flat and fade into its haze.
    scale = 52.0 / (rise + 0.09 * flat)
    value = cover[int(dy * scale + 8192.0) & 511, int(dx * scale + 8192.0) & 511] * (1.0 / 255.0)
    cloud = clamp((value - (1.0 - look[CLOUDS])) * 3.2, 0.0, 1.0) * min(rise * 11.0, 1.0)
    # Their undersides are darker.
    thick = 1.0 - 0.16 * clamp((value - 0.6) * 3.0, 0.0, 1.0)
    cloud *= 0.92
    cloud_r, cloud_g, cloud_b = triple(look, CLOUD)
    red += (cloud_r * thick - red) * cloud
    green += (cloud_g * thick - green) * cloud
    blue += (cloud_b * thick - blue) * cloud
    if look[GLOW] > 0.0:
        sun_x, sun_y, sun_z = triple(look, SUN)
        toward = (dx * sun_x + dy * sun_y + slope * sun_z) / math.sqrt(flat * flat + slope * slope)
        if toward > 0.0:
            glow = toward * toward
            glow *= glow
            wide = glow * look[GLOW]
            glow *= glow
            glow *= glow
            bright = (0.30 * wide + 0.9 * glow * glow * look[GLOW]) * (1.0 - 0.5 * cloud)
            red += (255.0 - red) * min(bright * 1.2, 1.0)
            green += (214.0 - green) * min(bright, 1.0) * 0.9
            blue += (150.0 - blue) * min(bright, 1.0) * 0.6
    return red, green, blue


@kernel
def code_at(x: float, y: float, ground: Any, frame: Any) -> int:
    """Return the ground's code at a place; beyond the raster there is grass."""
    # Unsigned: a place before the first cell becomes a number beyond the last.
    row = np.uint64(int((y - frame[1]) * frame[2]) & _UNSIGNED)
    column = np.uint64(int((x - frame[0]) * frame[2]) & _UNSIGNED)
    if row >= np.uint64(ground.shape[0]) or column >= np.uint64(ground.shape[1]):
        return int(3.0 + 7.0 * noise(floor(x * 0.5), floor(y * 0.5), 5)) & 15
    return int(ground[row, column] & 255)


@kernel
def kind_of(code: int) -> int:
    """Return the kind of ground that a code stands for: 0 for vegetation, else the number of its class."""
    return (code >> 4) & 3


@kernel
def ground_colour(column: Column, code: int, t: float, upper: float, lower: float, scene: Scene) -> Colour:
    """Return the colour of the ground at depth t; ``upper`` and ``lower`` are the depths a third of a row away."""
    look, px, py = column.look, column.px, column.py
    red, green, blue = triple(look, GROUND_COLOURS + 3 * code)
    if t > 10.0:
        # A far pixel covers much ground: take two more samples of the colour.
        dx, dy, ex, ey = column.dx, column.dy, column.ex, column.ey
        above = code_at(px + upper * (dx + ex), py + upper * (dy + ey), scene.ground, scene.frame)
        below = code_at(px + lower * (dx - ex), py + lower * (dy - ey), scene.ground, scene.frame)
        above_r, above_g, above_b = triple(look, GROUND_COLOURS + 3 * above)
        below_r, below_g, below_b = triple(look, GROUND_COLOURS + 3 * below)
        red = (red + above_r + below_r) * (1.0 / 3.0)
        green = (green + above_g + below_g) * (1.0 / 3.0)
        blue = (blue + above_b + below_b) * (1.0 / 3.0)
    return red, green, blue


@kernel
def mirror_share(x: float, y: float, slope: float, kind: int, look: Any, cover: Any) -> float:
    """Return how much of its colour wet ground takes from what it mirrors, 0 to 1."""
    # The flatter the ray, the more water mirrors. Pools stand in hollows.
    flat = 1.0 / (1.0 + 110.0 * slope * slope)
    hollow = cover[int(y * 22.0) & 511, int(x * 22.0) & 511] * 0.035 - 5.6
    pool = clamp(hollow, 0.0, 1.0)
    share: float = look[WETNESS] * (0.05 + 0.40 * flat + 0.30 * pool * (0.3 + 0.7 * flat))
    if kind == _SIDEWALK:
        share *= 0.5
    return share


@kernel
def mirrored_colour(column: Column, v: int, flat: float, base: float, slope: float, cover: Any) -> Colour:
    """Return what ground at row v mirrors: the nearest solid, whose foot is at row ``base``, or the sky."""
    row = int(2.0 * base - v + 0.5)
    if column.v1 - column.v0 > 1 and base < 1e6 and row >= column.v0 and row < v:
        pixel = column.canvas[row, column.u]
        return (pixel & 255) * 1.0, (pixel >> 8 & 255) * 1.0, (pixel >> 16 & 255) * 1.0
    return sky_colour(column, flat, -slope, cover)


@kernel
def ground_pixel(column: Column, v: int, flat: float, base: float, rows: Any, scene: Scene) -> None:
    """Paint the ground at row v; ``flat`` and ``base`` are those of :func:`background`."""
    look, slope, t = column.look, column.slopes[v], rows[REACH, v]
    x, y = column.px + t * column.dx, column.py + t * column.dy
    code = code_at(x, y, scene.ground, scene.frame) & 255
    red, green, blue = ground_colour(column, code, t, rows[UPPER, v], rows[LOWER, v], scene)
    shade = column.shade[v]
    red, green, blue = red * shade, green * shade, blue * shade
    kind = kind_of(code)
    if look[WETNESS] > 0.0 and kind > 0:
        share = mirror_share(x, y, slope, kind, look, scene.cover)
        mirrored_r, mirrored_g, mirrored_b = mirrored_colour(column, v, flat, base, slope, scene.cover)
        red += (mirrored_r - red) * share
        green += (mirrored_g - green) * share
        blue += (mirrored_b - blue) * share
    haze = rows[HAZE, v]
    haze_r, haze_g, haze_b = triple(look, HAZE_COLOUR)
    red, green, blue = red + (haze_r - red) * haze, green + (haze_g - green) * haze, blue + (haze_b - blue) * haze
    put(column.canvas, column.u, v, red, green, blue, kind if kind > 0 else _VEGETATION)


@kernel
def background(column: Column, base: float, rows: Any, scene: Scene) -> None:
    """Paint sky and ground where a column is still empty.

    ``base`` is the row of the foot of the nearest solid, which wet ground mirrors; 1e9 if there is none.
    """
    flat = math.sqrt(column.dx * column.dx + column.dy * column.dy)
    for v in range(column.v0, column.v1):
        if column.depth[v] < 1e8:
            continue
        if column.slopes[v] >= _LEVEL_RAY:
            red, green, blue = sky_colour(column, flat, column.slopes[v], scene.cover)
            put(column.canvas, column.u, v, red, green, blue, _SKY)
        else:
            ground_pixel(column, v, flat, base, rows, scene)


@kernel
def set_row(v: int, camera: Any, look: Any, rows: Any) -> None:
    """Set what the pixels of row v have in common: how far their rays rise, and where they meet the ground."""
    slope = (camera[CY] - v) / camera[FOCAL]
    if camera[LEVEL] < 0.5:
        slope = slope * camera[PITCH_COS] - camera[PITCH_SIN]
    eye, third = camera[UP], 0.33 / camera[FOCAL]
    rows[SLOPES, v] = slope
    if slope < _LEVEL_RAY:
        t = -eye / slope
        rows[REACH, v] = t
        rows[UPPER, v] = min(eye / max(-third - slope, 1e-5), 3.0 * t)
        rows[LOWER, v] = eye / (third - slope)
        rows[HAZE, v] = haze_at(t, look)
