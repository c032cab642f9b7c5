"""What can be seen through or past: trees and fences."""

import math
from typing import Any

from wrongturn_protocol.segmentation import SegmentationClass
from wrongturn_sim.camera.kernels import Column, clamp, first_row, floor, grain, haze_at, kernel, put_toned, turned
from wrongturn_sim.camera.solids import HALF_X, HALF_Z, HEIGHT, MIDDLE, R2, RADIUS, SEED, R, X, Y
from wrongturn_sim.camera.weathers import SUN

_VEGETATION = int(SegmentationClass.VEGETATION)
_WALL = int(SegmentationClass.WALL)


@kernel
def tree(column: Column, row: Any) -> None:
    """Paint a tree where it is the nearest: its trunk, then its crown."""
    dx, dy = column.dx, column.dy
    # From the trunk's axis to the camera.
    ox, oy = column.px - row[X], column.py - row[Y]
    flat = dx * dx + dy * dy
    along = -(ox * dx + oy * dy) / flat
    if along <= 0.3:
        return
    # Square of the distance at which the rays pass the axis.
    away = ox * ox + oy * oy - along * along * flat
    if away < row[HALF_X] * row[HALF_X]:
        trunk(column, ox, oy, along, math.sqrt((row[HALF_X] * row[HALF_X] - away) / flat), row)
    if away < row[RADIUS] * row[RADIUS]:
        crown(column, ox, oy, along, math.sqrt((row[RADIUS] * row[RADIUS] - away) / flat), row)


@kernel
def trunk(column: Column, ox: float, oy: float, along: float, reach: float, row: Any) -> None:
    """Paint a trunk; the rays pass its axis at depth ``along`` and enter it ``reach`` earlier."""
    dx, dy, eye = column.dx, column.dy, column.eye
    radius, seed = row[HALF_X], int(row[SEED])
    t = along - reach
    a = first_row((row[MIDDLE] - eye) / t, column)
    b = first_row(-eye / t, column)
    haze = haze_at(t, column.look)
    # The normal tells which side of the trunk the sun is on.
    nx, ny = (ox + t * dx) / radius, (oy + t * dy) / radius
    sun = max(0.0, nx * column.look[SUN] + ny * column.look[SUN + 1])
    cross = floor((dx * oy - dy * ox) * 12.0)
    for v in range(a, b):
        if t < column.depth[v]:
            column.depth[v] = t
            tone = 0.8 + 0.3 * grain(cross, floor((eye + column.slopes[v] * t) * 2.5), seed)
            put_toned(column, v, row, R2, tone, sun, haze, _VEGETATION)


@kernel
def crown(column: Column, ox: float, oy: float, along: float, reach: float, row: Any) -> None:
    """Paint a crown, a ragged ellipsoid; the rays are inside from ``along - reach`` to ``along + reach``."""
    dx, dy, eye, look = column.dx, column.dy, column.eye, column.look
    radius, middle, half_z, seed = row[RADIUS], row[MIDDLE], row[HALF_Z], int(row[SEED])
    near, far = max(along - reach, 0.3), along + reach
    top, bottom = middle + half_z, middle - half_z
    a = first_row((top - eye) / (near if top > eye else far), column)
    b = first_row((bottom - eye) / (far if bottom > eye else near), column)
    # The ray meets the ellipsoid where aa t² + 2 bb t + c = 0.
    inv_r, inv_z = 1.0 / (radius * radius), 1.0 / (half_z * half_z)
    oz = eye - middle
    flat_a = dx * dx + dy * dy
    flat_b = (ox * dx + oy * dy) * inv_r
    c = (ox * ox + oy * oy) * inv_r + oz * oz * inv_z - 1.0
    haze = haze_at(along, look)
    # Leaves grow with the distance, or they would glitter.
    fine = 3.2 if along < 28.0 else 1.6 if along < 60.0 else 0.8
    strength = clamp(1.3 - along / 110.0, 0.35, 1.0)
    for v in range(a, b):
        if column.depth[v] <= near:
            continue
        slope = column.slopes[v]
        aa = flat_a * inv_r + slope * slope * inv_z
        bb = flat_b + oz * slope * inv_z
        inside = bb * bb - aa * c
        if inside <= 0.0:
            continue
        t = (-bb - math.sqrt(inside)) / aa
        if t <= 0.3 or t >= column.depth[v]:
            continue
        wx, wy, wz = ox + t * dx, oy + t * dy, oz + t * slope
        leaf, bough = foliage(wx, wy, wz, fine, seed)
        rim = c + 1.0 - bb * bb / aa
        if rim + 0.30 * leaf + 0.22 * bough > 1.16:
            continue
        column.depth[v] = t
        nx, ny, nz = wx * inv_r * radius, wy * inv_r * radius, wz * inv_z * half_z
        facing = nx * look[SUN] + ny * look[SUN + 1] + nz * look[SUN + 2]
        sun = clamp(0.35 + 0.65 * facing, 0.0, 1.0)
        tone = (0.66 + 0.28 * nz) * (1.0 + strength * (0.62 * (leaf - 0.5) + 0.5 * (bough - 0.5)))
        put_toned(column, v, row, R, tone, sun, haze, _VEGETATION)


@kernel
def foliage(x: float, y: float, z: float, fine: float, seed: int) -> tuple[float, float]:
    """Return the texture of leaves and of boughs at a place of a crown, each 0 to 1."""
    leaf = grain(floor(x * fine) + floor(z * fine) * 57, floor(y * fine), seed)
    bough = grain(floor(x * 1.1 + 0.5) + 31 * floor(z * 1.1 + 0.5), floor(y * 1.1 + 0.5), seed + 5)
    return leaf, bough


@kernel
def fence(column: Column, x: float, y: float, row: Any) -> None:
    """Paint posts and rails where they are the nearest; the camera is at (x, y) in the fence's own frame."""
    ldx, ldy = turned(row, column.dx, column.dy)
    if ldy * y >= 0.0:
        return
    t = -y / ldy
    s = x + t * ldx
    if t <= 0.3 or abs(s) > row[HALF_X]:
        return
    look, eye, height = column.look, column.eye, row[HEIGHT]
    a = first_row((height - eye) / t, column)
    b = first_row(-eye / t, column)
    _, facing = turned(row, look[SUN], look[SUN + 1])
    sun = max(0.0, facing if y > 0.0 else -facing)
    haze = haze_at(t, look)
    place = (s + row[HALF_X]) / 1.7
    post = place - floor(place) < 0.085 or row[HALF_X] - abs(s) < 0.14
    tone = 1.0 if post else 0.9
    for v in range(a, b):
        if t >= column.depth[v]:
            continue
        part = (eye + column.slopes[v] * t) / height
        rail = part > 0.84 or (part > 0.50 and part < 0.64) or (part > 0.16 and part < 0.30)
        if post or rail:
            column.depth[v] = t
            put_toned(column, v, row, R, tone, sun, haze, _WALL)
