"""Sky and ground: what is behind and below everything else."""

import math
from typing import Any

from wrongturn_protocol import SegmentationClass
from wrongturn_sim.camera.kernels import clamp, haze_at, kernel, noise, put
from wrongturn_sim.camera.weathers import HEAD

_SKY = int(SegmentationClass.SKY)
_ROAD = int(SegmentationClass.ROAD)
_MARKING = int(SegmentationClass.LANE_MARKING)
_SIDEWALK = int(SegmentationClass.SIDEWALK)
_VEGETATION = int(SegmentationClass.VEGETATION)


@kernel
def sky_colour(dx: float, dy: float, slope: float, look: Any, cover: Any) -> tuple[float, float, float]:
    """Colour of the sky along a ray, 0 to 255."""
    flat = math.sqrt(dx * dx + dy * dy)
    rise = max(slope, 0.0) / flat
    share = rise / (rise + 0.16)
    red = look[12] + (look[9] - look[12]) * share
    green = look[13] + (look[10] - look[13]) * share
    blue = look[14] + (look[11] - look[14]) * share
    # Clouds lie on a plane far above: they grow flat towards the horizon and are lost in its haze.
    scale = 26.0 / (rise + 0.09) / flat
    x, y = dx * scale + 4096.0, dy * scale + 4096.0
    ix, iy = int(x), int(y)
    fx, fy = x - ix, y - iy
    ix, iy = ix & 255, iy & 255
    jx, jy = (ix + 1) & 255, (iy + 1) & 255
    low = cover[iy, ix] * (1.0 - fx) + cover[iy, jx] * fx
    high = cover[jy, ix] * (1.0 - fx) + cover[jy, jx] * fx
    value = (low * (1.0 - fy) + high * fy) * (1.0 / 255.0)
    cloud = clamp((value - (1.0 - look[20])) * 3.2, 0.0, 1.0) * clamp(rise * 11.0, 0.0, 1.0)
    # Their undersides are darker.
    thick = 1.0 - 0.16 * clamp((value - 0.6) * 3.0, 0.0, 1.0)
    cloud *= 0.92
    red += (look[21] * thick - red) * cloud
    green += (look[22] * thick - green) * cloud
    blue += (look[23] * thick - blue) * cloud
    if look[26] > 0.0:
        toward = (dx * look[0] + dy * look[1] + slope * look[2]) / math.sqrt(flat * flat + slope * slope)
        if toward > 0.0:
            glow = toward * toward
            glow *= glow
            wide = glow * look[26]
            glow *= glow
            glow *= glow
            bright = (0.30 * wide + 0.9 * glow * glow * look[26]) * (1.0 - 0.5 * cloud)
            red += (255.0 - red) * min(bright * 1.2, 1.0)
            green += (214.0 - green) * min(bright, 1.0) * 0.9
            blue += (150.0 - blue) * min(bright, 1.0) * 0.6
    return red, green, blue


@kernel
def sky_pixel(
    u: int, v: int, dx: float, dy: float, slope: float, look: Any, cover: Any, rgb: Any, segmentation: Any
) -> None:
    red, green, blue = sky_colour(dx, dy, slope, look, cover)
    put(rgb, segmentation, u, v, red, green, blue, _SKY)


@kernel
def code_at(x: float, y: float, ground: Any, frame: Any) -> int:
    """The ground's code at a place; grass beyond the raster."""
    row, column = int((y - frame[1]) * frame[2]), int((x - frame[0]) * frame[2])
    if x < frame[0] or y < frame[1] or row >= ground.shape[0] or column >= ground.shape[1]:
        return int(3.0 + 7.0 * noise(int(math.floor(x * 0.5)), int(math.floor(y * 0.5)), 5))
    return int(ground[row, column])


@kernel
def seen_of(code: int) -> int:
    """The segmentation's class of a code."""
    kind = (code >> 4) & 3
    return _VEGETATION if kind == 0 else _ROAD if kind == 1 else _MARKING if kind == 2 else _SIDEWALK


@kernel
def ground_pixel(
    u: int,
    v: int,
    t: float,
    dx: float,
    dy: float,
    ex: float,
    ey: float,
    px: float,
    py: float,
    eye: float,
    half: float,
    slope: float,
    shade: float,
    base: float,
    top: int,
    single: bool,
    cy: float,
    dull: float,
    ground: Any,
    frame: Any,
    look: Any,
    cover: Any,
    rgb: Any,
    segmentation: Any,
) -> None:
    """Paints the ground.

    ``ex``, ``ey``: a quarter of a column to the right; ``half``: a quarter of a row, as a slope; ``base``, ``top``: the
    row of the nearest solid's foot and its first row, which a wet ground mirrors, in the same column.
    """
    code = code_at(px + t * dx, py + t * dy, ground, frame)
    at = HEAD + 3 * code
    red, green, blue = look[at], look[at + 1], look[at + 2]
    if t > 9.0:
        # Far pixels cover much ground: four more samples, of the colour alone.
        for corner in range(4):
            side = 1.0 if corner & 1 else -1.0
            row = half if corner & 2 else -half
            far = eye / max(row * (0.5 if corner & 1 else 1.0) - slope, 1e-4)
            far = min(far, 4.0 * t)
            at = HEAD + 3 * code_at(px + far * (dx + side * ex), py + far * (dy + side * ey), ground, frame)
            red += look[at]
            green += look[at + 1]
            blue += look[at + 2]
        red, green, blue = red * 0.2, green * 0.2, blue * 0.2
    red, green, blue = red * shade, green * shade, blue * shade
    kind = (code >> 4) & 3
    if look[19] > 0.0 and kind > 0:
        # Water mirrors the more, the flatter the ray; in hollows it stands.
        flat = 1.0 / (1.0 + 90.0 * slope * slope)
        x, y = px + t * dx, py + t * dy
        hollow = cover[int(y * 11.0) & 255, int(x * 11.0) & 255] + 0.0
        pool = clamp((hollow - 150.0) * 0.035, 0.0, 1.0) * (1.0 if kind != 3 else 0.4)
        share = look[19] * (0.10 + 0.52 * flat + 0.34 * pool * (0.35 + 0.65 * flat)) * (0.6 if kind == 3 else 1.0)
        mirrored = int(2.0 * base - v + 0.5)
        if not single and base < 1e6 and mirrored >= top and mirrored < v and mirrored >= 0:
            share *= dull
            red += (rgb[mirrored, u, 0] - red) * share
            green += (rgb[mirrored, u, 1] - green) * share
            blue += (rgb[mirrored, u, 2] - blue) * share
        else:
            sky_r, sky_g, sky_b = sky_colour(dx, dy, -slope, look, cover)
            red += (sky_r - red) * share
            green += (sky_g - green) * share
            blue += (sky_b - blue) * share
    haze = haze_at(t, look)
    put(
        rgb,
        segmentation,
        u,
        v,
        red + (look[15] - red) * haze,
        green + (look[16] - green) * haze,
        blue + (look[17] - blue) * haze,
        seen_of(code),
    )
