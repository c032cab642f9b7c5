"""What can be seen through or past: trees and fences."""

import math
from typing import Any

from wrongturn_protocol import SegmentationClass
from wrongturn_sim.camera.kernels import clamp, first_row, floor, grain, haze_at, kernel, put
from wrongturn_sim.camera.solids import (
    B2,
    COS,
    G2,
    HALF_X,
    HALF_Z,
    HEIGHT,
    MIDDLE,
    R2,
    RADIUS,
    SEED,
    SIN,
    B,
    G,
    R,
    X,
    Y,
)
from wrongturn_sim.camera.weathers import (
    HAZE_B,
    HAZE_G,
    HAZE_R,
    SKYLIGHT_B,
    SKYLIGHT_G,
    SKYLIGHT_R,
    SUN_X,
    SUN_Y,
    SUN_Z,
    SUNLIGHT_B,
    SUNLIGHT_G,
    SUNLIGHT_R,
)

_VEGETATION = int(SegmentationClass.VEGETATION)
_WALL = int(SegmentationClass.WALL)


@kernel
def tree(
    u: int,
    v0: int,
    v1: int,
    dx: float,
    dy: float,
    px: float,
    py: float,
    eye: float,
    focal: float,
    cy: float,
    row: Any,
    look: Any,
    slopes: Any,
    depth: Any,
    canvas: Any,
) -> None:
    """Paints a tree where it is the nearest: its trunk, then its crown."""
    ox, oy = px - row[X], py - row[Y]
    flat = dx * dx + dy * dy
    along = -(ox * dx + oy * dy) / flat
    if along <= 0.3:
        return
    away = ox * ox + oy * oy - along * along * flat
    radius, middle, half_z = row[RADIUS], row[MIDDLE], row[HALF_Z]
    seed = int(row[SEED])
    trunk = row[HALF_X]
    if away < trunk * trunk:
        side = math.sqrt((trunk * trunk - away) / flat)
        t = along - side
        a = first_row((middle - eye) / t, v0, v1, focal, cy, slopes)
        b = first_row(-eye / t, v0, v1, focal, cy, slopes)
        haze = haze_at(t, look)
        clear = 1.0 - haze
        # The normal tells which side of the trunk the sun is on.
        nx, ny = (ox + t * dx) / trunk, (oy + t * dy) / trunk
        sun = max(0.0, nx * look[SUN_X] + ny * look[SUN_Y])
        cross = floor((dx * oy - dy * ox) * 12.0)
        for v in range(a, b):
            if t < depth[v]:
                depth[v] = t
                tone = 0.8 + 0.3 * grain(cross, floor((eye + slopes[v] * t) * 2.5), seed)
                put(
                    canvas,
                    u,
                    v,
                    row[R2] * tone * (look[SKYLIGHT_R] + sun * look[SUNLIGHT_R]) * clear + look[HAZE_R] * haze,
                    row[G2] * tone * (look[SKYLIGHT_G] + sun * look[SUNLIGHT_G]) * clear + look[HAZE_G] * haze,
                    row[B2] * tone * (look[SKYLIGHT_B] + sun * look[SUNLIGHT_B]) * clear + look[HAZE_B] * haze,
                    _VEGETATION,
                )
    if away >= radius * radius:
        return
    reach = math.sqrt((radius * radius - away) / flat)
    near, far = max(along - reach, 0.3), along + reach
    top, bottom = middle + half_z, middle - half_z
    a = first_row((top - eye) / (near if top > eye else far), v0, v1, focal, cy, slopes)
    b = first_row((bottom - eye) / (far if bottom > eye else near), v0, v1, focal, cy, slopes)
    inv_r, inv_z = 1.0 / (radius * radius), 1.0 / (half_z * half_z)
    oz = eye - middle
    flat_b = (ox * dx + oy * dy) * inv_r
    c = (ox * ox + oy * oy) * inv_r + oz * oz * inv_z - 1.0
    haze = haze_at(along, look)
    clear = 1.0 - haze
    # Leaves grow with the distance, or they would glitter.
    fine = 3.2 if along < 28.0 else 1.6 if along < 60.0 else 0.8
    strength = clamp(1.3 - along / 110.0, 0.35, 1.0)
    for v in range(a, b):
        if depth[v] <= near:
            continue
        slope = slopes[v]
        aa = flat * inv_r + slope * slope * inv_z
        bb = flat_b + oz * slope * inv_z
        inside = bb * bb - aa * c
        if inside <= 0.0:
            continue
        t = (-bb - math.sqrt(inside)) / aa
        if t <= 0.3 or t >= depth[v]:
            continue
        wx, wy, wz = ox + t * dx, oy + t * dy, oz + t * slope
        ix, iy, iz = floor(wx * fine), floor(wy * fine), floor(wz * fine)
        leaf = grain(ix + iz * 57, iy, seed)
        rim = c + 1.0 - bb * bb / aa
        bough = grain(
            floor(wx * 1.1 + 0.5) + 31 * floor(wz * 1.1 + 0.5),
            floor(wy * 1.1 + 0.5),
            seed + 5,
        )
        if rim + 0.30 * leaf + 0.22 * bough > 1.16:
            continue
        depth[v] = t
        nx, ny, nz = wx * inv_r * radius, wy * inv_r * radius, wz * inv_z * half_z
        facing = nx * look[SUN_X] + ny * look[SUN_Y] + nz * look[SUN_Z]
        sun = clamp(0.35 + 0.65 * facing, 0.0, 1.0)
        tone = (0.66 + 0.28 * nz) * (1.0 + strength * (0.62 * (leaf - 0.5) + 0.5 * (bough - 0.5)))
        put(
            canvas,
            u,
            v,
            row[R] * tone * (look[SKYLIGHT_R] + sun * look[SUNLIGHT_R]) * clear + look[HAZE_R] * haze,
            row[G] * tone * (look[SKYLIGHT_G] + sun * look[SUNLIGHT_G]) * clear + look[HAZE_G] * haze,
            row[B] * tone * (look[SKYLIGHT_B] + sun * look[SUNLIGHT_B]) * clear + look[HAZE_B] * haze,
            _VEGETATION,
        )


@kernel
def fence(
    u: int,
    v0: int,
    v1: int,
    dx: float,
    dy: float,
    rx: float,
    ry: float,
    eye: float,
    focal: float,
    cy: float,
    row: Any,
    look: Any,
    slopes: Any,
    depth: Any,
    canvas: Any,
) -> None:
    """Paints posts and rails where they are the nearest."""
    ldx = row[COS] * dx + row[SIN] * dy
    ldy = row[COS] * dy - row[SIN] * dx
    if ldy * ry >= 0.0:
        return
    t = -ry / ldy
    s = rx + t * ldx
    if t <= 0.3 or abs(s) > row[HALF_X]:
        return
    height = row[HEIGHT]
    a = first_row((height - eye) / t, v0, v1, focal, cy, slopes)
    b = first_row(-eye / t, v0, v1, focal, cy, slopes)
    sign = 1.0 if ry > 0.0 else -1.0
    sun = max(0.0, sign * (row[COS] * look[SUN_Y] - row[SIN] * look[SUN_X]))
    haze = haze_at(t, look)
    clear = 1.0 - haze
    place = (s + row[HALF_X]) / 1.7
    post = place - floor(place) < 0.085 or row[HALF_X] - abs(s) < 0.14
    for v in range(a, b):
        if t >= depth[v]:
            continue
        y = (eye + slopes[v] * t) / height
        rail = (y > 0.84) or (y > 0.50 and y < 0.64) or (y > 0.16 and y < 0.30)
        if not (post or rail):
            continue
        depth[v] = t
        tone = 1.0 if post else 0.9
        put(
            canvas,
            u,
            v,
            row[R] * tone * (look[SKYLIGHT_R] + sun * look[SUNLIGHT_R]) * clear + look[HAZE_R] * haze,
            row[G] * tone * (look[SKYLIGHT_G] + sun * look[SUNLIGHT_G]) * clear + look[HAZE_G] * haze,
            row[B] * tone * (look[SKYLIGHT_B] + sun * look[SUNLIGHT_B]) * clear + look[HAZE_B] * haze,
            _WALL,
        )
