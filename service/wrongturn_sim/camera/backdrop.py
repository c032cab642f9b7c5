"""Sky and ground: what is behind and below everything else."""

import math
from typing import Any

import numpy as np

from wrongturn_protocol.segmentation import SegmentationClass
from wrongturn_sim.camera import kernels, weathers
from wrongturn_sim.camera.kernels import Colour, Column, Scene, clamp, kernel, mix, put, toned, triple
from wrongturn_sim.camera.pinhole import CY, FOCAL, LEVEL, PITCH_COS, PITCH_SIN, UP

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
    colour = mix(triple(look, weathers.HORIZON), triple(look, weathers.ZENITH), rise / (rise + 0.16 * flat))
    # Clouds lie on a plane far above. Towards the horizon they become flat and fade into its haze.
    scale = 52.0 / (rise + 0.09 * flat)
    value = cover[int(dy * scale + 8192.0) & 511, int(dx * scale + 8192.0) & 511] * (1.0 / 255.0)
    cloud = clamp((value - (1.0 - look[weathers.CLOUDS])) * 3.2, 0.0, 1.0) * min(rise * 11.0, 1.0)
    # Their undersides are darker.
    thick = 1.0 - 0.16 * clamp((value - 0.6) * 3.0, 0.0, 1.0)
    cloud *= 0.92
    colour = mix(colour, toned(triple(look, weathers.CLOUD), thick), cloud)
    if look[weathers.GLOW] > 0.0:
        sun_x, sun_y, sun_z = triple(look, weathers.SUN)
        toward = (dx * sun_x + dy * sun_y + slope * sun_z) / math.sqrt(flat * flat + slope * slope)
        if toward > 0.0:
            glow = toward * toward
            glow *= glow
            wide = glow * look[weathers.GLOW]
            glow *= glow
            glow *= glow
            bright = (0.30 * wide + 0.9 * glow * glow * look[weathers.GLOW]) * (1.0 - 0.5 * cloud)
            red, green, blue = colour
            red += (255.0 - red) * min(bright * 1.2, 1.0)
            green += (214.0 - green) * min(bright, 1.0) * 0.9
            blue += (150.0 - blue) * min(bright, 1.0) * 0.6
            colour = red, green, blue
    return colour


@kernel
def code_at(x: float, y: float, ground: Any, frame: Any) -> int:
    """Return the ground's code at a place; beyond the raster there is grass."""
    # Unsigned: a place before the first cell becomes a number beyond the last.
    row = np.uint64(int((y - frame[1]) * frame[2]) & _UNSIGNED)
    column = np.uint64(int((x - frame[0]) * frame[2]) & _UNSIGNED)
    if row >= np.uint64(ground.shape[0]) or column >= np.uint64(ground.shape[1]):
        return int(3.0 + 7.0 * kernels.noise(kernels.floor(x * 0.5), kernels.floor(y * 0.5), 5)) & 15
    return int(ground[row, column] & 255)


@kernel
def ground_colour(column: Column, code: int, t: float, upper: float, lower: float, scene: Scene) -> Colour:
    """Return the colour of the ground at depth t; ``upper`` and ``lower`` are the depths a third of a row away."""
    look, px, py = column.look, column.px, column.py
    here = triple(look, weathers.GROUND_COLOURS + 3 * code)
    if t <= 10.0:
        return here
    # A far pixel covers much ground: take two more samples of the colour.
    dx, dy, ex, ey = column.dx, column.dy, column.ex, column.ey
    above = code_at(px + upper * (dx + ex), py + upper * (dy + ey), scene.ground, scene.frame)
    below = code_at(px + lower * (dx - ex), py + lower * (dy - ey), scene.ground, scene.frame)
    high, low = triple(look, weathers.GROUND_COLOURS + 3 * above), triple(look, weathers.GROUND_COLOURS + 3 * below)
    return toned((here[0] + high[0] + low[0], here[1] + high[1] + low[1], here[2] + high[2] + low[2]), 1.0 / 3.0)


@kernel
def mirror_share(x: float, y: float, slope: float, kind: int, look: Any, cover: Any) -> float:
    """Return how much of its colour wet ground takes from what it mirrors, 0 to 1."""
    # The flatter the ray, the more water mirrors. Pools stand in hollows.
    flat = 1.0 / (1.0 + 110.0 * slope * slope)
    hollow = cover[int(y * 22.0) & 511, int(x * 22.0) & 511] * 0.035 - 5.6
    pool = clamp(hollow, 0.0, 1.0)
    share: float = look[weathers.WETNESS] * (0.05 + 0.40 * flat + 0.30 * pool * (0.3 + 0.7 * flat))
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
    look, slope, t = column.look, column.slopes[v], rows[kernels.REACH, v]
    x, y = column.px + t * column.dx, column.py + t * column.dy
    code = code_at(x, y, scene.ground, scene.frame) & 255
    colour = toned(
        ground_colour(column, code, t, rows[kernels.UPPER, v], rows[kernels.LOWER, v], scene), column.shade[v]
    )
    kind = (code >> 4) & 3
    if look[weathers.WETNESS] > 0.0 and kind > 0:
        share = mirror_share(x, y, slope, kind, look, scene.cover)
        colour = mix(colour, mirrored_colour(column, v, flat, base, slope, scene.cover), share)
    colour = mix(colour, triple(look, weathers.HAZE_COLOUR), rows[kernels.HAZE, v])
    put(column, v, colour, kind if kind > 0 else _VEGETATION)


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
            put(column, v, sky_colour(column, flat, column.slopes[v], scene.cover), _SKY)
        else:
            ground_pixel(column, v, flat, base, rows, scene)


@kernel
def set_row(v: int, camera: Any, look: Any, rows: Any) -> None:
    """Set what the pixels of row v have in common: how far their rays rise, and where they meet the ground."""
    slope = (camera[CY] - v) / camera[FOCAL]
    if camera[LEVEL] < 0.5:
        slope = slope * camera[PITCH_COS] - camera[PITCH_SIN]
    eye, third = camera[UP], 0.33 / camera[FOCAL]
    rows[kernels.SLOPES, v] = slope
    if slope < _LEVEL_RAY:
        t = -eye / slope
        rows[kernels.REACH, v] = t
        rows[kernels.UPPER, v] = min(eye / max(-third - slope, 1e-5), 3.0 * t)
        rows[kernels.LOWER, v] = eye / (third - slope)
        rows[kernels.HAZE, v] = kernels.haze_at(t, look)
