"""Sky and ground: what is behind and below everything else."""

import math
from typing import Any

import numpy as np

from wrongturn_protocol import SegmentationClass
from wrongturn_sim.camera.kernels import HAZE, LOWER, REACH, SLOPES, UPPER, clamp, floor, haze_at, kernel, noise, put
from wrongturn_sim.camera.pinhole import CY, FOCAL, LEVEL, PITCH_COS, PITCH_SIN, UP
from wrongturn_sim.camera.weathers import (
    CLOUD_B,
    CLOUD_G,
    CLOUD_R,
    CLOUDS,
    GLOW,
    GROUND_COLOURS,
    HAZE_B,
    HAZE_G,
    HAZE_R,
    HORIZON_B,
    HORIZON_G,
    HORIZON_R,
    SUN_X,
    SUN_Y,
    SUN_Z,
    WETNESS,
    ZENITH_B,
    ZENITH_G,
    ZENITH_R,
)

_SKY = int(SegmentationClass.SKY)
_VEGETATION = int(SegmentationClass.VEGETATION)
_UNSIGNED = (1 << 63) - 1


@kernel
def sky_colour(dx: float, dy: float, flat: float, slope: float, look: Any, cover: Any) -> tuple[float, float, float]:
    """Colour of the sky along a ray, 0 to 255; ``flat``: the length of (dx, dy)."""
    rise = max(slope, 0.0)
    share = rise / (rise + 0.16 * flat)
    red = look[HORIZON_R] + (look[ZENITH_R] - look[HORIZON_R]) * share
    green = look[HORIZON_G] + (look[ZENITH_G] - look[HORIZON_G]) * share
    blue = look[HORIZON_B] + (look[ZENITH_B] - look[HORIZON_B]) * share
    # Clouds lie on a plane far above: they grow flat towards the horizon and are lost in its haze.
    scale = 52.0 / (rise + 0.09 * flat)
    value = cover[int(dy * scale + 8192.0) & 511, int(dx * scale + 8192.0) & 511] * (1.0 / 255.0)
    cloud = clamp((value - (1.0 - look[CLOUDS])) * 3.2, 0.0, 1.0) * min(rise * 11.0, 1.0)
    # Their undersides are darker.
    thick = 1.0 - 0.16 * clamp((value - 0.6) * 3.0, 0.0, 1.0)
    cloud *= 0.92
    red += (look[CLOUD_R] * thick - red) * cloud
    green += (look[CLOUD_G] * thick - green) * cloud
    blue += (look[CLOUD_B] * thick - blue) * cloud
    if look[GLOW] > 0.0:
        toward = (dx * look[SUN_X] + dy * look[SUN_Y] + slope * look[SUN_Z]) / math.sqrt(flat * flat + slope * slope)
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
def sky_pixel(
    u: int, v: int, dx: float, dy: float, length: float, slope: float, look: Any, cover: Any, canvas: Any
) -> None:
    """Paints the sky."""
    red, green, blue = sky_colour(dx, dy, length, slope, look, cover)
    put(canvas, u, v, red, green, blue, _SKY)


@kernel
def code_at(x: float, y: float, ground: Any, frame: Any) -> int:
    """The ground's code at a place; grass beyond the raster."""
    # Unsigned: what lies before the first cell becomes a number beyond the last.
    row = np.uint64(int((y - frame[1]) * frame[2]) & _UNSIGNED)
    column = np.uint64(int((x - frame[0]) * frame[2]) & _UNSIGNED)
    if row >= np.uint64(ground.shape[0]) or column >= np.uint64(ground.shape[1]):
        return int(3.0 + 7.0 * noise(floor(x * 0.5), floor(y * 0.5), 5)) & 15
    return int(ground[row, column] & 255)


@kernel
def seen_of(code: int) -> int:
    """The segmentation's class of a code."""
    kind = (code >> 4) & 3
    # The others are numbered as their classes are.
    return kind if kind > 0 else _VEGETATION


@kernel
def ground_pixel(
    u: int,
    v: int,
    dx: float,
    dy: float,
    length: float,
    ex: float,
    ey: float,
    px: float,
    py: float,
    t: float,
    upper: float,
    lower: float,
    haze: float,
    slope: float,
    shade: float,
    base: float,
    top: int,
    single: bool,
    ground: Any,
    frame: Any,
    look: Any,
    cover: Any,
    canvas: Any,
) -> None:
    """Paints the ground at depth t.

    ``upper``, ``lower``: the depth a third of a row above and below; ``ex``, ``ey``: a third of a column to the right;
    ``base``, ``top``: the row of the nearest solid's foot and its first row, which wet ground mirrors, in this column.
    """
    x, y = px + t * dx, py + t * dy
    code = code_at(x, y, ground, frame) & 255
    at = GROUND_COLOURS + 3 * code
    red, green, blue = look[at], look[at + 1], look[at + 2]
    if t > 10.0:
        # Far pixels cover much ground: more samples, of the colour alone.
        at = GROUND_COLOURS + 3 * code_at(px + upper * (dx + ex), py + upper * (dy + ey), ground, frame)
        more = GROUND_COLOURS + 3 * code_at(px + lower * (dx - ex), py + lower * (dy - ey), ground, frame)
        red = (red + look[at] + look[more]) * (1.0 / 3.0)
        green = (green + look[at + 1] + look[more + 1]) * (1.0 / 3.0)
        blue = (blue + look[at + 2] + look[more + 2]) * (1.0 / 3.0)
    red, green, blue = red * shade, green * shade, blue * shade
    kind = (code >> 4) & 3
    if look[WETNESS] > 0.0 and kind > 0:
        # Water mirrors the more, the flatter the ray; in hollows it stands.
        flat = 1.0 / (1.0 + 110.0 * slope * slope)
        hollow = cover[int(y * 22.0) & 511, int(x * 22.0) & 511] * 0.035 - 5.6
        pool = clamp(hollow, 0.0, 1.0)
        share = look[WETNESS] * (0.05 + 0.40 * flat + 0.30 * pool * (0.3 + 0.7 * flat))
        if kind == 3:
            share *= 0.5
        mirrored = int(2.0 * base - v + 0.5)
        if not single and base < 1e6 and mirrored >= top and mirrored < v and mirrored >= 0:
            image = canvas[mirrored, u]
            red += ((image & 255) - red) * share
            green += ((image >> 8 & 255) - green) * share
            blue += ((image >> 16 & 255) - blue) * share
        else:
            sky_r, sky_g, sky_b = sky_colour(dx, dy, length, -slope, look, cover)
            red += (sky_r - red) * share
            green += (sky_g - green) * share
            blue += (sky_b - blue) * share
    put(
        canvas,
        u,
        v,
        red + (look[HAZE_R] - red) * haze,
        green + (look[HAZE_G] - green) * haze,
        blue + (look[HAZE_B] - blue) * haze,
        seen_of(code),
    )


@kernel
def set_row(v: int, camera: Any, look: Any, rows: Any) -> None:
    """What the pixels of a row have in common: how their rays rise for each metre of depth, and where they end."""
    slope = (camera[CY] - v) / camera[FOCAL]
    if camera[LEVEL] < 0.5:
        slope = slope * camera[PITCH_COS] - camera[PITCH_SIN]
    eye, third = camera[UP], 0.33 / camera[FOCAL]
    rows[SLOPES, v] = slope
    if slope < -1e-4:
        t = -eye / slope
        rows[REACH, v] = t
        rows[UPPER, v] = min(eye / max(-third - slope, 1e-5), 3.0 * t)
        rows[LOWER, v] = eye / (third - slope)
        rows[HAZE, v] = haze_at(t, look)
