"""Upright boxes, with or without a pitched roof, in one column."""

import math
from typing import Any

from wrongturn_sim.camera.backdrop import code_at
from wrongturn_sim.camera.facades import house_run, lit, top_pixel, wall_run
from wrongturn_sim.camera.kernels import Scene, first_row, kernel
from wrongturn_sim.camera.solids import COS, HALF_X, HALF_Y, HEIGHT, HOUSE, KIND, RISE, SIN
from wrongturn_sim.camera.weathers import SHADOW_BIT, SUN_X, SUN_Y, SUN_Z


@kernel
def cross(x: float, y: float, dx: float, dy: float, half_x: float, half_y: float) -> tuple[float, float]:
    """Where a ray enters and leaves a rectangle; it misses where it enters no earlier than it leaves."""
    # Almost along a side is along it: no branch for what never happens twice.
    inv_x = 1.0 / (dx if abs(dx) > 1e-9 else 1e-9)
    inv_y = 1.0 / (dy if abs(dy) > 1e-9 else 1e-9)
    mid_x, reach_x = -x * inv_x, half_x * abs(inv_x)
    mid_y, reach_y = -y * inv_y, half_y * abs(inv_y)
    return max(mid_x - reach_x, mid_y - reach_y), min(mid_x + reach_x, mid_y + reach_y)


@kernel
def solid(
    u: int,
    v0: int,
    hidden: int,
    v1: int,
    t: float,
    out: float,
    dx: float,
    dy: float,
    x: float,
    y: float,
    px: float,
    py: float,
    eye: float,
    focal: float,
    cy: float,
    row: Any,
    look: Any,
    scene: Scene,
    slopes: Any,
    depth: Any,
    canvas: Any,
) -> int:
    """Paints a solid above row ``hidden``; returns the row that it covers down from."""
    ldx, ldy = row[COS] * dx + row[SIN] * dy, row[COS] * dy - row[SIN] * dx
    half_x, half_y = row[HALF_X], row[HALF_Y]
    kind = int(row[KIND])
    lx, ly = x + t * ldx, y + t * ldy
    along_x = half_x - abs(lx) < half_y - abs(ly)
    top = row[HEIGHT]
    rise = row[RISE]
    if rise > 0.0:
        top += rise * max(0.0, 1.0 - abs(ly) / half_y)
    b = min(first_row(-eye / t, v0, v1, focal, cy, slopes), hidden)
    a = first_row((top - eye) / t, v0, v1, focal, cy, slopes)
    if a < b:
        sign = (1.0 if lx > 0.0 else -1.0) if along_x else (1.0 if ly > 0.0 else -1.0)
        sun = lit(row, along_x, sign, look)
        # Where the ground before it lies in the shade, so does its lower part.
        foot = t - 0.7
        if sun > 0.0 and code_at(px + foot * dx, py + foot * dy, scene.ground, scene.frame) & int(look[SHADOW_BIT]):
            sun *= 0.25
        s = ly if along_x else lx
        if kind == HOUSE:
            tilt = abs(ldx if along_x else ldy) / math.sqrt(ldx * ldx + ldy * ldy)
            house_run(u, a, b, t, tilt, s, along_x, sun, eye, focal, row, look, slopes, scene.shops, canvas)
        else:
            wall_run(u, a, b, t, s, sun, eye, row, kind, look, slopes, canvas)
        for v in range(a, b):
            depth[v] = t
    hidden = min(hidden, max(a, v0))
    if rise > 0.0:
        # The slope towards the camera, up to the ridge.
        if ldy * ly < 0.0:
            ridge = min(-y / ldy, out)
            crest = row[HEIGHT] + rise * max(0.0, 1.0 - abs(y + ridge * ldy) / half_y)
            if ridge > t + 1e-6:
                steep = (crest - top) / (ridge - t)
                r = first_row((crest - eye) / ridge, v0, v1, focal, cy, slopes)
                sign = 1.0 if ly > 0.0 else -1.0
                lean = rise / half_y
                norm = 1.0 / math.sqrt(1.0 + lean * lean)
                sun = lean * sign * (row[COS] * look[SUN_Y] - row[SIN] * look[SUN_X]) + look[SUN_Z]
                sun = max(0.0, sun * norm)
                for v in range(r, hidden):
                    far = (top - steep * t - eye) / (slopes[v] - steep)
                    depth[v] = far
                    top_pixel(u, v, far, x + far * ldx, y + far * ldy, row, kind, sun, look, canvas)
                hidden = min(hidden, max(r, v0))
    elif top < eye:
        r = first_row((top - eye) / out, v0, v1, focal, cy, slopes)
        for v in range(r, hidden):
            far = (top - eye) / slopes[v]
            depth[v] = far
            top_pixel(u, v, far, x + far * ldx, y + far * ldy, row, kind, look[SUN_Z], look, canvas)
        hidden = min(hidden, max(r, v0))
    return hidden
