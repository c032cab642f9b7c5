"""The ray caster: it paints one column of the picture after the other.

The rays of a column lie in one upright plane. So one test finds where all of them meet a solid, and the pinhole formula
gives the rows that the solid covers. Solids are painted from front to back, each above the rows that nearer ones cover.
Then come the things that can be seen past (trees, fences, road users), by depth, and last sky and ground. The rays of a
pitched camera's column do not lie in one plane: for it, the same functions take one pixel at a time.
"""

from typing import Any

from wrongturn_judge.compiling import compiled
from wrongturn_sim.camera import kernels
from wrongturn_sim.camera.backdrop import background, set_row
from wrongturn_sim.camera.kernels import OPTIONS, Column, Eye, Scene, Scratch, eye_of, kernel, noise, turned
from wrongturn_sim.camera.pinhole import CX, CY, FOCAL, LEVEL, PITCH_COS, PITCH_SIN, UP
from wrongturn_sim.camera.prisms import cross, hit_of, solid
from wrongturn_sim.camera.road_users import car, row_of_other, shade_below, walker
from wrongturn_sim.camera.sight import in_sight
from wrongturn_sim.camera.solids import CAR, FENCE, HALF_X, HALF_Y, KIND, TREE
from wrongturn_sim.camera.thin import fence, tree
from wrongturn_sim.camera.weathers import HORIZON, RAIN, STREAK


@kernel
def meet(column: Column, scenery: Any, scratch: Scratch) -> tuple[int, bool]:
    """Write the solids that a column's rays meet, nearest first, to its work area.

    Returns their number, and whether the column also has trees, fences or road users.
    """
    first, last, which = scratch.work[kernels.FIRST], scratch.work[kernels.LAST], scratch.work[kernels.WHICH]
    place, listed = scratch.place, scratch.lists[column.u]
    still, met, others = scenery.shape[0], 0, False
    for position in range(scratch.counts[column.u]):
        item = listed[position]
        if item >= still or scenery[item, KIND] >= TREE:
            others = True
            continue
        row = scenery[item]
        ldx, ldy = turned(row, column.dx, column.dy)
        t, out = cross(place[item, 0], place[item, 1], ldx, ldy, row[HALF_X], row[HALF_Y])
        if t >= out or t < kernels.NEAR:
            continue
        slot = met
        while slot > 0 and first[slot - 1] > t:
            slot -= 1
        if slot >= kernels.HITS:
            continue
        met = min(met + 1, kernels.HITS)
        for move in range(met - 1, slot, -1):
            first[move], last[move], which[move] = first[move - 1], last[move - 1], which[move - 1]
        first[slot], last[slot], which[slot] = t, out, item
    return met, others


@kernel
def paint_others(column: Column, scenery: Any, scratch: Scratch) -> None:
    """Paint the trees, fences and road users of a column where they are the nearest."""
    place, listed = scratch.place, scratch.lists[column.u]
    still = scenery.shape[0]
    for position in range(scratch.counts[column.u]):
        item = listed[position]
        x, y = place[item, 0], place[item, 1]
        if item >= still:
            row = scratch.users[item - still]
            shade_below(column, x, y, row)
            if row[KIND] == CAR:
                car(column, x, y, row)
            else:
                walker(column, row)
        elif scenery[item, KIND] == TREE:
            tree(column, scenery[item])
        elif scenery[item, KIND] == FENCE:
            fence(column, x, y, scenery[item])


@kernel
def cast(column: Column, scene: Scene, scratch: Scratch) -> None:
    """Paint the rows of a column."""
    work, place = scratch.work, scratch.place
    first, last, which = work[kernels.FIRST], work[kernels.LAST], work[kernels.WHICH]
    for v in range(column.v0, column.v1):
        column.depth[v] = 1e9
        column.shade[v] = 1.0
    met, others = meet(column, scene.scenery, scratch)
    hidden = column.v1
    for nth in range(met):
        item = int(which[nth])
        row = scene.scenery[item]
        hit = hit_of(column, first[nth], last[nth], place[item, 0], place[item, 1], row)
        hidden = solid(column, hidden, hit, row, scene)
        if hidden <= column.v0:
            break
    if others:
        paint_others(column, scene.scenery, scratch)
    base = column.cy + column.focal * column.eye / first[0] if met > 0 else 1e9
    background(column, base, scratch.rows, scene)


@kernel
def column_into(u: int, eye: Eye, camera: Any, look: Any, scene: Scene, scratch: Scratch) -> None:
    """Paint column u on the canvas; its solids are listed and its rows are set."""
    height = scratch.canvas.shape[0]
    focal, cy = camera[FOCAL], camera[CY]
    slopes, depth, shade = scratch.rows[kernels.SLOPES], scratch.work[kernels.DEPTH], scratch.work[kernels.SHADE]
    # A third of a column to the right.
    ex, ey = 0.33 * eye.ahead_y / focal, -0.33 * eye.ahead_x / focal
    left = (camera[CX] - u) / focal
    # The columns of a level camera are cast whole, those of a pitched camera pixel by pixel.
    level = camera[LEVEL] > 0.5
    for part in range(1 if level else height):
        ahead, v0, v1 = 1.0, 0, height
        if not level:
            ahead, v0, v1 = camera[PITCH_COS] + (cy - part) / focal * camera[PITCH_SIN], part, part + 1
        dx, dy = eye.ahead_x * ahead - eye.ahead_y * left, eye.ahead_y * ahead + eye.ahead_x * left
        column = Column(
            u, v0, v1, eye.x, eye.y, dx, dy, ex, ey, camera[UP], focal, cy, look, slopes, depth, shade, scratch.canvas
        )
        cast(column, scene, scratch)


@kernel
def show(v: int, u: int, canvas: Any, rgb: Any, segmentation: Any) -> None:
    """Copy a pixel of the canvas to the pictures."""
    pixel = canvas[v, u]
    rgb[v, u, 0] = pixel & 255
    rgb[v, u, 1] = pixel >> 8 & 255
    rgb[v, u, 2] = pixel >> 16 & 255
    segmentation[v, u] = pixel >> 24


@kernel
def streak(drop: int, begin: int, end: int, look: Any, seed: int, tick: int, rgb: Any) -> None:
    """Paint the part of a raindrop that is in columns begin to end."""
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
                rgb[row, column, channel] = int(value + (0.5 * look[HORIZON + channel] + 112.0 - value) * alpha)


@kernel
def rain(begin: int, end: int, look: Any, seed: int, tick: int, rgb: Any) -> None:
    """Paint the rain that is in columns begin to end; each tick has other drops."""
    for drop in range(int(look[RAIN] * rgb.shape[1] * rgb.shape[0] / 64.0)):
        streak(drop, begin, end, look, seed, tick, rgb)


@kernel
def picture_into(
    pose: Any, seed: int, tick: int, others: Any, camera: Any, look: Any, scene: Scene, scratch: Scratch, rgb: Any,
    segmentation: Any,
) -> None:  # fmt: skip
    """Paint one picture."""
    height, width = segmentation.shape
    eye = eye_of(pose[0], pose[1], pose[2], camera)
    for u in range(width):
        scratch.counts[u] = 0
    still = scene.scenery.shape[0]
    for item in range(still):
        in_sight(item, scene.scenery[item], eye, camera, width, height, scratch)
    for other in range(others.shape[0]):
        row = scratch.users[other]
        row_of_other(others[other], row)
        in_sight(still + other, row, eye, camera, width, height, scratch)
    for v in range(height):
        set_row(v, camera, look, scratch.rows)
    for u in range(width):
        column_into(u, eye, camera, look, scene, scratch)
    for v in range(height):
        for u in range(width):
            show(v, u, scratch.canvas, rgb, segmentation)
    rain(0, width, look, seed, tick, rgb)


@compiled(**OPTIONS)
def pictures_into(
    poses: Any, seeds: Any, ticks: Any, others: Any, begins: Any, looks: Any, camera: Any, ground: Any, frame: Any,
    scenery: Any, shops: Any, cover: Any, rows: Any, work: Any, place: Any, counts: Any, lists: Any, users: Any,
    canvas: Any, rgb: Any, segmentation: Any,
) -> None:  # fmt: skip
    """Paint pictures one after the other; the road users of picture i are rows begins[i] to begins[i + 1]."""
    # Built here from plain arrays: numba takes a quarter of a picture's time to unpack a named tuple from Python.
    scene = Scene(ground, frame, scenery, shops, cover)
    scratch = Scratch(rows, work, place, counts, lists, users, canvas)
    for i in range(poses.shape[0]):
        users_of = others[begins[i] : begins[i + 1]]
        picture_into(poses[i], seeds[i], ticks[i], users_of, camera, looks[i], scene, scratch, rgb[i], segmentation[i])
