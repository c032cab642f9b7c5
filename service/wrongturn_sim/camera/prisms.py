"""Upright boxes, with or without a pitched roof, in one column."""

import math
from typing import Any, NamedTuple

from wrongturn_sim.camera.backdrop import code_at
from wrongturn_sim.camera.facades import Face, house_run, lit, top_pixel, wall_run
from wrongturn_sim.camera.kernels import Column, Scene, first_row, kernel, triple, turned
from wrongturn_sim.camera.solids import COS, HALF_X, HALF_Y, HEIGHT, HOUSE, KIND, RISE, SIN
from wrongturn_sim.camera.weathers import SHADOW_BIT, SUN


class Hit(NamedTuple):
    """Where a column's rays meet a solid; all but the depths in the solid's own frame."""

    t: float
    """Depth at which they enter, metres."""
    out: float
    """Depth at which they leave."""
    x: float
    """The camera's place."""
    y: float
    dx: float
    """How far the rays go for each metre of depth."""
    dy: float


@kernel
def cross(x: float, y: float, dx: float, dy: float, half_x: float, half_y: float) -> tuple[float, float]:
    """Return where a ray enters and leaves a rectangle; it misses where it enters no earlier than it leaves."""
    # A ray almost along a side counts as along it. That saves a branch which is hardly ever taken.
    inv_x = 1.0 / (dx if abs(dx) > 1e-9 else 1e-9)
    inv_y = 1.0 / (dy if abs(dy) > 1e-9 else 1e-9)
    mid_x, reach_x = -x * inv_x, half_x * abs(inv_x)
    mid_y, reach_y = -y * inv_y, half_y * abs(inv_y)
    return max(mid_x - reach_x, mid_y - reach_y), min(mid_x + reach_x, mid_y + reach_y)


@kernel
def crest(row: Any, y: float) -> float:
    """Return how high a pitched roof rises above the eaves, y metres from its ridge on the flat."""
    high: float = row[RISE] * max(0.0, 1.0 - abs(y) / row[HALF_Y])
    return high


@kernel
def front(column: Column, a: int, b: int, hit: Hit, row: Any, scene: Scene) -> None:
    """Paint rows a to b of the upright face that the rays enter through."""
    t, look = hit.t, column.look
    lx, ly = hit.x + t * hit.dx, hit.y + t * hit.dy
    along_x = row[HALF_X] - abs(lx) < row[HALF_Y] - abs(ly)
    sign = (1.0 if lx > 0.0 else -1.0) if along_x else (1.0 if ly > 0.0 else -1.0)
    sun = lit(row, along_x, sign, look)
    # Where the ground before the face lies in the shade, so does its lower part.
    foot = t - 0.7
    x, y = column.px + foot * column.dx, column.py + foot * column.dy
    if sun > 0.0 and code_at(x, y, scene.ground, scene.frame) & int(look[SHADOW_BIT]):
        sun *= 0.25
    s = ly if along_x else lx
    if int(row[KIND]) == HOUSE:
        tilt = abs(hit.dx if along_x else hit.dy) / math.sqrt(hit.dx * hit.dx + hit.dy * hit.dy)
        house_run(column, a, b, Face(t, s, along_x, tilt, sun), row, scene.shops)
    else:
        wall_run(column, a, b, t, s, sun, row)
    for v in range(a, b):
        column.depth[v] = t


@kernel
def pitched_roof(column: Column, hidden: int, hit: Hit, row: Any) -> int:
    """Paint the slope of a roof that faces the camera, up to its ridge; return the first row that it covers."""
    t, look = hit.t, column.look
    ly = hit.y + t * hit.dy
    if hit.dy * ly >= 0.0:
        return hidden
    top = row[HEIGHT] + crest(row, ly)
    ridge = min(-hit.y / hit.dy, hit.out)
    if ridge <= t + 1e-6:
        return hidden
    high = row[HEIGHT] + crest(row, hit.y + ridge * hit.dy)
    steep = (high - top) / (ridge - t)
    first = first_row((high - column.eye) / ridge, column)
    sign = 1.0 if ly > 0.0 else -1.0
    sun_x, sun_y, sun_z = triple(look, SUN)
    lean = row[RISE] / row[HALF_Y]
    norm = 1.0 / math.sqrt(1.0 + lean * lean)
    sun = lean * sign * (row[COS] * sun_y - row[SIN] * sun_x) + sun_z
    sun = max(0.0, sun * norm)
    for v in range(first, hidden):
        far = (top - steep * t - column.eye) / (column.slopes[v] - steep)
        column.depth[v] = far
        top_pixel(column, v, far, hit.x + far * hit.dx, hit.y + far * hit.dy, sun, row)
    return min(hidden, max(first, column.v0))


@kernel
def flat_top(column: Column, hidden: int, hit: Hit, row: Any) -> int:
    """Paint the top of a solid that is lower than the camera; return the first row that it covers."""
    rise = row[HEIGHT] - column.eye
    first = first_row(rise / hit.out, column)
    for v in range(first, hidden):
        far = rise / column.slopes[v]
        column.depth[v] = far
        top_pixel(column, v, far, hit.x + far * hit.dx, hit.y + far * hit.dy, column.look[SUN + 2], row)
    return min(hidden, max(first, column.v0))


@kernel
def solid(column: Column, hidden: int, hit: Hit, row: Any, scene: Scene) -> int:
    """Paint a solid above row ``hidden``, from which nearer solids cover the column; return the new such row."""
    t = hit.t
    top = row[HEIGHT]
    if row[RISE] > 0.0:
        top += crest(row, hit.y + t * hit.dy)
    b = min(first_row(-column.eye / t, column), hidden)
    a = first_row((top - column.eye) / t, column)
    if a < b:
        front(column, a, b, hit, row, scene)
    hidden = min(hidden, max(a, column.v0))
    if row[RISE] > 0.0:
        return pitched_roof(column, hidden, hit, row)
    if top < column.eye:
        return flat_top(column, hidden, hit, row)
    return hidden


@kernel
def hit_of(column: Column, t: float, out: float, x: float, y: float, row: Any) -> Hit:
    """Return where a column's rays meet a solid, from the depths and the camera's place in the solid's frame."""
    dx, dy = turned(row, column.dx, column.dy)
    return Hit(t, out, x, y, dx, dy)
