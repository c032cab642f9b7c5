"""The ray caster: one column of the picture after the other.

A column's rays lie in one upright plane, so that a solid is met once for the whole column, and the rows it covers
follow from the pinhole formula. Solids are painted front to back, each above what the nearer ones cover; then what can
be seen past (trees, fences, road users), by depth; then sky and ground. With a pitched camera the rays of a column no
longer lie in one plane: the same functions then take one pixel at a time.
"""

import math
from typing import Any

from wrongturn_protocol import segmentation as segmentation_classes
from wrongturn_sim.camera import backdrop, facades, kernels, pinhole, prisms, road_users, sight, solids, thin, weathers
from wrongturn_sim.camera.backdrop import ground_pixel, set_row, sky_pixel
from wrongturn_sim.camera.kernels import (
    DEPTH,
    FIRST,
    HAZE,
    HITS,
    LAST,
    LOWER,
    NEAR,
    OPTIONS,
    REACH,
    SHADE,
    SLOPES,
    UPPER,
    WHICH,
    Scene,
    Scratch,
    kernel,
    noise,
)
from wrongturn_sim.camera.pinhole import CAMERA_YAW, CX, CY, FOCAL, FORWARD, LEFT, LEVEL, PITCH_COS, PITCH_SIN, UP
from wrongturn_sim.camera.prisms import cross, solid
from wrongturn_sim.camera.road_users import car, row_of_other, shade_below, walker
from wrongturn_sim.camera.sight import in_sight
from wrongturn_sim.camera.solids import CAR, COS, FENCE, HALF_X, HALF_Y, KIND, SIN, TREE
from wrongturn_sim.camera.thin import fence, tree
from wrongturn_sim.camera.weathers import HORIZON_R, RAIN, STREAK
from wrongturn_sim.compiling import compiled_with


@kernel
def meet(u: int, dx: float, dy: float, scenery: Any, scratch: Scratch) -> tuple[int, bool]:
    """Notes the solids that a column's rays meet, nearest first; their number, and whether there are others."""
    first, last, which = scratch.work[FIRST], scratch.work[LAST], scratch.work[WHICH]
    place, listed = scratch.place, scratch.lists[u]
    still, met, others = scenery.shape[0], 0, False
    for position in range(scratch.counts[u]):
        item = listed[position]
        if item >= still or scenery[item, KIND] >= TREE:
            others = True
            continue
        row = scenery[item]
        ldx, ldy = row[COS] * dx + row[SIN] * dy, row[COS] * dy - row[SIN] * dx
        t, out = cross(place[item, 0], place[item, 1], ldx, ldy, row[HALF_X], row[HALF_Y])
        if t >= out or t < NEAR:
            continue
        slot = met
        while slot > 0 and first[slot - 1] > t:
            slot -= 1
        if slot >= HITS:
            continue
        met = min(met + 1, HITS)
        for move in range(met - 1, slot, -1):
            first[move], last[move], which[move] = first[move - 1], last[move - 1], which[move - 1]
        first[slot], last[slot], which[slot] = t, out, item
    return met, others


@kernel
def paint_others(
    u: int,
    v0: int,
    v1: int,
    dx: float,
    dy: float,
    px: float,
    py: float,
    camera: Any,
    look: Any,
    scenery: Any,
    scratch: Scratch,
) -> None:
    """Paints what does not cover a column from the ground up, where it is the nearest."""
    focal, cy, eye = camera[FOCAL], camera[CY], camera[UP]
    slopes, depth, shade = scratch.rows[SLOPES], scratch.work[DEPTH], scratch.work[SHADE]
    place, listed, canvas = scratch.place, scratch.lists[u], scratch.canvas
    still = scenery.shape[0]
    for position in range(scratch.counts[u]):
        item = listed[position]
        x, y = place[item, 0], place[item, 1]
        if item >= still:
            row = scratch.users[item - still]
            shade_below(v0, v1, dx, dy, x, y, eye, focal, cy, row, slopes, shade)
            if row[KIND] == CAR:
                car(u, v0, v1, dx, dy, x, y, eye, focal, cy, row, look, slopes, depth, canvas)
            else:
                walker(u, v0, v1, dx, dy, px, py, eye, focal, cy, row, look, slopes, depth, canvas)
        elif scenery[item, KIND] == TREE:
            tree(u, v0, v1, dx, dy, px, py, eye, focal, cy, scenery[item], look, slopes, depth, canvas)
        elif scenery[item, KIND] == FENCE:
            fence(u, v0, v1, dx, dy, x, y, eye, focal, cy, scenery[item], look, slopes, depth, canvas)


@kernel
def cast(
    u: int,
    v0: int,
    v1: int,
    dx: float,
    dy: float,
    ex: float,
    ey: float,
    px: float,
    py: float,
    camera: Any,
    look: Any,
    scene: Scene,
    scratch: Scratch,
) -> None:
    """Paints rows v0 to v1 of a column, whose rays go the way (dx, dy) on the flat for each metre of depth."""
    focal, cy, eye = camera[FOCAL], camera[CY], camera[UP]
    rows, work, place, canvas = scratch.rows, scratch.work, scratch.place, scratch.canvas
    slopes, depth, shade = rows[SLOPES], work[DEPTH], work[SHADE]
    first, last, which = work[FIRST], work[LAST], work[WHICH]
    for v in range(v0, v1):
        depth[v] = 1e9
        shade[v] = 1.0
    met, others = meet(u, dx, dy, scene.scenery, scratch)
    hidden = v1
    for hit in range(met):
        item = int(which[hit])
        hidden = solid(
            u,
            v0,
            hidden,
            v1,
            first[hit],
            last[hit],
            dx,
            dy,
            place[item, 0],
            place[item, 1],
            px,
            py,
            eye,
            focal,
            cy,
            scene.scenery[item],
            look,
            scene,
            slopes,
            depth,
            canvas,
        )
        if hidden <= v0:
            break
    if others:
        paint_others(u, v0, v1, dx, dy, px, py, camera, look, scene.scenery, scratch)
    # What wet ground mirrors of this column: the nearest solid, as far as it was painted.
    base, top = (cy + focal * eye / first[0], v0) if met > 0 else (1e9, v1)
    single = v1 - v0 == 1
    length = math.sqrt(dx * dx + dy * dy)
    reach, upper, lower, haze = rows[REACH], rows[UPPER], rows[LOWER], rows[HAZE]
    for v in range(v0, v1):
        if depth[v] < 1e8:
            continue
        slope = slopes[v]
        if slope >= -1e-4:
            sky_pixel(u, v, dx, dy, length, slope, look, scene.cover, canvas)
        else:
            ground_pixel(
                u,
                v,
                dx,
                dy,
                length,
                ex,
                ey,
                px,
                py,
                reach[v],
                upper[v],
                lower[v],
                haze[v],
                slope,
                shade[v],
                base,
                top,
                single,
                scene.ground,
                scene.frame,
                look,
                scene.cover,
                canvas,
            )


@kernel
def column_into(
    u: int, px: float, py: float, fx: float, fy: float, camera: Any, look: Any, scene: Scene, scratch: Scratch
) -> None:
    """Paints a column, whose solids are listed and whose rows are set, on the canvas."""
    height = scratch.canvas.shape[0]
    focal, cx, cy = camera[FOCAL], camera[CX], camera[CY]
    # A third of a column to the right.
    ex, ey = 0.33 * fy / focal, -0.33 * fx / focal
    a = (cx - u) / focal
    # A level camera's columns are cast whole, those of a pitched one pixel by pixel.
    level = camera[LEVEL] > 0.5
    for part in range(1 if level else height):
        ahead, v0, v1 = 1.0, 0, height
        if not level:
            ahead, v0, v1 = camera[PITCH_COS] + (cy - part) / focal * camera[PITCH_SIN], part, part + 1
        cast(u, v0, v1, fx * ahead - fy * a, fy * ahead + fx * a, ex, ey, px, py, camera, look, scene, scratch)


@kernel
def show(v: int, u: int, canvas: Any, rgb: Any, segmentation: Any) -> None:
    """A pixel of the canvas as colours and class."""
    pixel = canvas[v, u]
    rgb[v, u, 0] = pixel & 255
    rgb[v, u, 1] = pixel >> 8 & 255
    rgb[v, u, 2] = pixel >> 16 & 255
    segmentation[v, u] = pixel >> 24


@kernel
def streak(drop: int, begin: int, end: int, look: Any, seed: int, tick: int, rgb: Any) -> None:
    """A drop of rain, as far as it falls in columns begin to end."""
    height, width = rgb.shape[0], rgb.shape[1]
    u = int(noise(drop, tick, seed) * (width - 0.01))
    if u + 1 < begin or u >= end:
        return
    v = int(noise(drop, tick, seed + 7919) * (height + 8)) - 8
    near = noise(drop, tick, seed + 104729)
    length = int(look[STREAK] * (0.5 + near)) + 1
    alpha = 0.10 + 0.20 * near
    lean = noise(drop, tick, seed + 1299709) < 0.35
    for step in range(length):
        row = v + step
        column = u + (1 if lean and 2 * step > length else 0)
        if row >= 0 and row < height and column >= begin and column < end:
            for channel in range(3):
                value = rgb[row, column, channel] + 0.0
                rgb[row, column, channel] = int(value + (0.5 * look[HORIZON_R + channel] + 112.0 - value) * alpha)


@kernel
def rain(begin: int, end: int, look: Any, seed: int, tick: int, rgb: Any) -> None:
    """Streaks over columns begin to end, others at each tick."""
    for drop in range(int(look[RAIN] * rgb.shape[1] * rgb.shape[0] / 64.0)):
        streak(drop, begin, end, look, seed, tick, rgb)


@kernel
def eye_of(x: float, y: float, yaw: float, camera: Any) -> tuple[float, float, float, float]:
    """Where the camera of a car stands, and which way it looks on the flat."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    px = x + camera[FORWARD] * cos - camera[LEFT] * sin
    py = y + camera[FORWARD] * sin + camera[LEFT] * cos
    return px, py, math.cos(yaw + camera[CAMERA_YAW]), math.sin(yaw + camera[CAMERA_YAW])


@kernel
def frame_into(
    pose: Any,
    seed: int,
    tick: int,
    others: Any,
    camera: Any,
    look: Any,
    scene: Scene,
    scratch: Scratch,
    rgb: Any,
    segmentation: Any,
) -> None:
    """Paints one picture."""
    height, width = segmentation.shape
    px, py, fx, fy = eye_of(pose[0], pose[1], pose[2], camera)
    for u in range(width):
        scratch.counts[u] = 0
    still = scene.scenery.shape[0]
    for item in range(still):
        in_sight(item, scene.scenery[item], px, py, fx, fy, camera, width, height, scratch)
    for other in range(others.shape[0]):
        row = scratch.users[other]
        row_of_other(others[other], row)
        in_sight(still + other, row, px, py, fx, fy, camera, width, height, scratch)
    for v in range(height):
        set_row(v, camera, look, scratch.rows)
    for u in range(width):
        column_into(u, px, py, fx, fy, camera, look, scene, scratch)
    for v in range(height):
        for u in range(width):
            show(v, u, scratch.canvas, rgb, segmentation)
    rain(0, width, look, seed, tick, rgb)


@compiled_with(
    backdrop,
    facades,
    kernels,
    pinhole,
    prisms,
    road_users,
    segmentation_classes,
    sight,
    solids,
    thin,
    weathers,
    **OPTIONS,
)
def frames_into(
    poses: Any,
    seeds: Any,
    ticks: Any,
    others: Any,
    begins: Any,
    looks: Any,
    camera: Any,
    ground: Any,
    frame: Any,
    scenery: Any,
    shops: Any,
    cover: Any,
    rows: Any,
    work: Any,
    place: Any,
    counts: Any,
    lists: Any,
    users: Any,
    canvas: Any,
    rgb: Any,
    segmentation: Any,
) -> None:
    """Paints pictures, one after the other; of picture i the road users are rows begins[i] to begins[i + 1]."""
    # Made here of plain arrays: to look through a named tuple, numba takes a quarter of a picture's time.
    scene = Scene(ground, frame, scenery, shops, cover)
    scratch = Scratch(rows, work, place, counts, lists, users, canvas)
    for i in range(poses.shape[0]):
        users_of = others[begins[i] : begins[i + 1]]
        frame_into(poses[i], seeds[i], ticks[i], users_of, camera, looks[i], scene, scratch, rgb[i], segmentation[i])
