"""The ray caster: who is in sight, then one column of the picture after the other.

A column's rays lie in one upright plane, so that a solid is met once for the whole column, and the rows it covers
follow from the pinhole formula. Solids are painted front to back, each above what the nearer ones cover; then what can
be seen past (trees, fences, road users), by depth; then sky and ground. With a pitched camera the rays of a column no
longer lie in one plane: the same functions then take one pixel at a time.
"""

import hashlib
import math
from pathlib import Path
from typing import Any, Final

import numba

from wrongturn_sim.camera.backdrop import code_at, ground_pixel, sky_pixel
from wrongturn_sim.camera.facades import house_run, lit, top_pixel, wall_run
from wrongturn_sim.camera.kernels import clamp, first_row, haze_at, kernel, noise
from wrongturn_sim.camera.road_users import car, row_of_other, shade_below, walker
from wrongturn_sim.camera.solids import (
    BOUND,
    CAR,
    COS,
    FENCE,
    HALF_X,
    HALF_Y,
    HEIGHT,
    HOUSE,
    KIND,
    RISE,
    SIN,
    TREE,
    X,
    Y,
)
from wrongturn_sim.camera.thin import fence, tree

NEAR: Final = 0.25
"""What is nearer than this is not drawn, metres."""
FAR: Final = 420.0
HITS: Final = 48
"""Solids that a column can meet; of more, the nearest are kept."""

# Rows of the work area, each as long as the picture is high (and at least HITS).
SLOPES, DEPTH, SHADE, FIRST, LAST, WHICH = range(6)
WORK: Final = 6


@kernel
def in_sight(
    item: int,
    row: Any,
    px: float,
    py: float,
    fx: float,
    fy: float,
    camera: Any,
    width: int,
    height: int,
    place: Any,
    counts: Any,
    lists: Any,
) -> None:
    """Notes a solid in the lists of the columns in which it may be seen; its camera's place in its own frame."""
    ox, oy = row[X] - px, row[Y] - py
    ahead, aside, bound = ox * fx + oy * fy, oy * fx - ox * fy, row[BOUND]
    if ahead < -bound or ahead > FAR:
        return
    place[item, 0] = -(row[COS] * ox + row[SIN] * oy)
    place[item, 1] = -(row[COS] * oy - row[SIN] * ox)
    begin, end = 0, width
    near, far = ahead - bound, ahead + bound
    tilt_cos, tilt_sin, focal, cx = camera[6], camera[7], camera[0], camera[1]
    # How far ahead a ray goes on the flat for each metre of depth, at the upper and lower edge.
    upper = tilt_cos + camera[2] / focal * tilt_sin
    lower = tilt_cos - (height - 1 - camera[2]) / focal * tilt_sin
    least, most = min(upper, lower), max(upper, lower)
    if near > 0.5 and least > 0.1:
        left, right = aside + bound, aside - bound
        left /= near if left > 0.0 else far
        right /= far if right > 0.0 else near
        left *= most if left > 0.0 else least
        right *= least if right > 0.0 else most
        begin = int(clamp(math.floor(cx - focal * left), 0.0, width * 1.0))
        end = int(clamp(math.ceil(cx - focal * right) + 1.0, 0.0, width * 1.0))
    for u in range(begin, end):
        lists[u, counts[u]] = item
        counts[u] += 1


@kernel
def cross(x: float, y: float, dx: float, dy: float, half_x: float, half_y: float) -> tuple[float, float, bool]:
    """Where a ray enters and leaves a rectangle, and whether through an end (across the local x axis)."""
    in_x, out_x, in_y, out_y = -1e9, 1e9, -1e9, 1e9
    if dx != 0.0:
        in_x, out_x = (-half_x - x) / dx, (half_x - x) / dx
        if in_x > out_x:
            in_x, out_x = out_x, in_x
    elif abs(x) > half_x:
        return 1.0, 0.0, False
    if dy != 0.0:
        in_y, out_y = (-half_y - y) / dy, (half_y - y) / dy
        if in_y > out_y:
            in_y, out_y = out_y, in_y
    elif abs(y) > half_y:
        return 1.0, 0.0, False
    return max(in_x, in_y), min(out_x, out_y), in_x > in_y


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
    ground: Any,
    frame: Any,
    shops: Any,
    work: Any,
    rgb: Any,
    segmentation: Any,
) -> int:
    """Paints a solid above row ``hidden``; returns the row that it covers down from."""
    slopes, depth = work[SLOPES], work[DEPTH]
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
        if sun > 0.0 and t < 120.0:
            # Where the ground before it lies in the shade, so does its lower part.
            if code_at(px + (t - 0.7) * dx, py + (t - 0.7) * dy, ground, frame) & int(look[28]):
                sun *= 0.25
        s = ly if along_x else lx
        if kind == HOUSE:
            tilt = abs(ldx if along_x else ldy) / math.sqrt(ldx * ldx + ldy * ldy)
            house_run(u, a, b, t, tilt, s, along_x, sun, eye, focal, row, look, slopes, shops, rgb, segmentation)
        else:
            wall_run(u, a, b, t, s, sun, eye, row, kind, look, slopes, rgb, segmentation)
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
                sun = lean * sign * (row[COS] * look[1] - row[SIN] * look[0]) + look[2]
                sun = max(0.0, sun * norm)
                for v in range(r, hidden):
                    far = (top - steep * t - eye) / (slopes[v] - steep)
                    depth[v] = far
                    top_pixel(u, v, far, x + far * ldx, y + far * ldy, row, kind, sun, look, rgb, segmentation)
                hidden = min(hidden, max(r, v0))
    elif top < eye:
        r = first_row((top - eye) / out, v0, v1, focal, cy, slopes)
        for v in range(r, hidden):
            far = (top - eye) / slopes[v]
            depth[v] = far
            top_pixel(u, v, far, x + far * ldx, y + far * ldy, row, kind, look[2], look, rgb, segmentation)
        hidden = min(hidden, max(r, v0))
    return hidden


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
    ground: Any,
    frame: Any,
    scenery: Any,
    users: Any,
    shops: Any,
    cover: Any,
    place: Any,
    count: int,
    listed: Any,
    work: Any,
    rgb: Any,
    segmentation: Any,
) -> None:
    """Paints rows v0 to v1 of a column, whose rays go the way (dx, dy) on the flat for each metre of depth."""
    focal, cy, eye = camera[0], camera[2], camera[5]
    slopes, depth, shade = work[SLOPES], work[DEPTH], work[SHADE]
    first, last, which = work[FIRST], work[LAST], work[WHICH]
    still = scenery.shape[0]
    for v in range(v0, v1):
        depth[v] = 1e9
        shade[v] = 1.0
    met = 0
    thin = False
    for position in range(count):
        item = listed[position]
        if item >= still:
            thin = True
            continue
        row = scenery[item]
        kind = row[KIND]
        if kind >= TREE:
            thin = True
            continue
        ldx, ldy = row[COS] * dx + row[SIN] * dy, row[COS] * dy - row[SIN] * dx
        t, out, _ = cross(place[item, 0], place[item, 1], ldx, ldy, row[HALF_X], row[HALF_Y])
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
    hidden = v1
    for hit in range(met):
        item = int(which[hit])
        row = scenery[item]
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
            row,
            look,
            ground,
            frame,
            shops,
            work,
            rgb,
            segmentation,
        )
        if hidden <= v0:
            break
    if thin:
        for position in range(count):
            item = listed[position]
            if item >= still:
                row = users[item - still]
                shade_below(v0, v1, dx, dy, place[item, 0], place[item, 1], eye, focal, cy, row, slopes, shade)
                if row[KIND] == CAR:
                    car(
                        u,
                        v0,
                        v1,
                        dx,
                        dy,
                        place[item, 0],
                        place[item, 1],
                        eye,
                        focal,
                        cy,
                        row,
                        look,
                        slopes,
                        depth,
                        rgb,
                        segmentation,
                    )
                else:
                    walker(u, v0, v1, dx, dy, px, py, eye, focal, cy, row, look, slopes, depth, rgb, segmentation)
            elif scenery[item, KIND] == TREE:
                tree(u, v0, v1, dx, dy, px, py, eye, focal, cy, scenery[item], look, slopes, depth, rgb, segmentation)
            elif scenery[item, KIND] == FENCE:
                fence(
                    u,
                    v0,
                    v1,
                    dx,
                    dy,
                    place[item, 0],
                    place[item, 1],
                    eye,
                    focal,
                    cy,
                    scenery[item],
                    look,
                    slopes,
                    depth,
                    rgb,
                    segmentation,
                )
    base, top, dull = 1e9, v1, 1.0
    if met > 0:
        base = cy + focal * eye / first[0]
        top = v0
    single = v1 - v0 == 1
    for v in range(v0, v1):
        if depth[v] < 1e8:
            continue
        slope = slopes[v]
        if slope >= -1e-4:
            sky_pixel(u, v, dx, dy, slope, look, cover, rgb, segmentation)
        else:
            ground_pixel(
                u,
                v,
                -eye / slope,
                dx,
                dy,
                ex,
                ey,
                px,
                py,
                eye,
                0.25 / focal,
                slope,
                shade[v],
                base,
                top,
                single,
                cy,
                dull,
                ground,
                frame,
                look,
                cover,
                rgb,
                segmentation,
            )


@kernel
def rain(look: Any, seed: int, tick: int, rgb: Any) -> None:
    """Streaks over the picture, others at each tick."""
    height, width = rgb.shape[0], rgb.shape[1]
    count = int(look[24] * width * height / 64.0)
    for drop in range(count):
        u = int(noise(drop, tick, seed) * (width - 0.01))
        v = int(noise(drop, tick, seed + 7919) * (height + 8)) - 8
        near = noise(drop, tick, seed + 104729)
        length = int(look[25] * (0.5 + near)) + 1
        alpha = 0.10 + 0.20 * near
        lean = noise(drop, tick, seed + 1299709) < 0.35
        for step in range(length):
            row = v + step
            column = u + (1 if lean and 2 * step > length else 0)
            if row >= 0 and row < height and column < width:
                for channel in range(3):
                    value = rgb[row, column, channel] + 0.0
                    rgb[row, column, channel] = int(value + (0.5 * look[12 + channel] + 112.0 - value) * alpha)


@kernel
def frame_into(
    x: float,
    y: float,
    yaw: float,
    seed: int,
    tick: int,
    others: Any,
    camera: Any,
    look: Any,
    ground: Any,
    frame: Any,
    scenery: Any,
    shops: Any,
    cover: Any,
    work: Any,
    place: Any,
    counts: Any,
    lists: Any,
    users: Any,
    rgb: Any,
    segmentation: Any,
) -> None:
    """Paints one picture."""
    height, width = segmentation.shape
    focal, cx, cy = camera[0], camera[1], camera[2]
    cos, sin = math.cos(yaw), math.sin(yaw)
    px = x + camera[3] * cos - camera[4] * sin
    py = y + camera[3] * sin + camera[4] * cos
    fx, fy = math.cos(yaw + camera[8]), math.sin(yaw + camera[8])
    for u in range(width):
        counts[u] = 0
    still = scenery.shape[0]
    for item in range(still):
        in_sight(item, scenery[item], px, py, fx, fy, camera, width, height, place, counts, lists)
    for other in range(others.shape[0]):
        row_of_other(others[other], users[other])
        in_sight(still + other, users[other], px, py, fx, fy, camera, width, height, place, counts, lists)
    ex, ey = 0.25 * fy / focal, -0.25 * fx / focal
    slopes = work[SLOPES]
    if camera[9] > 0.5:
        for v in range(height):
            slopes[v] = (cy - v) / focal
        for u in range(width):
            a = (cx - u) / focal
            cast(
                u,
                0,
                height,
                fx - fy * a,
                fy + fx * a,
                ex,
                ey,
                px,
                py,
                camera,
                look,
                ground,
                frame,
                scenery,
                users,
                shops,
                cover,
                place,
                counts[u],
                lists[u],
                work,
                rgb,
                segmentation,
            )
    else:
        tilt_cos, tilt_sin = camera[6], camera[7]
        for u in range(width):
            a = (cx - u) / focal
            for v in range(height):
                b = (cy - v) / focal
                slopes[v] = b * tilt_cos - tilt_sin
                ahead = tilt_cos + b * tilt_sin
                cast(
                    u,
                    v,
                    v + 1,
                    fx * ahead - fy * a,
                    fy * ahead + fx * a,
                    ex,
                    ey,
                    px,
                    py,
                    camera,
                    look,
                    ground,
                    frame,
                    scenery,
                    users,
                    shops,
                    cover,
                    place,
                    counts[u],
                    lists[u],
                    work,
                    rgb,
                    segmentation,
                )
    if look[24] > 0.0:
        rain(look, seed, tick, rgb)


def _digest() -> int:
    """Of the kernels' sources: numba looks for changes only in the file of the function that it keeps."""
    sources = sorted(Path(__file__).parent.glob("*.py"))
    return int.from_bytes(hashlib.sha256(b"".join(file.read_bytes() for file in sources)).digest()[:7], "big")


def _compiled(version: int) -> Any:
    @numba.njit(cache=True, fastmath=True, error_model="numpy", nogil=True)
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
        work: Any,
        place: Any,
        counts: Any,
        lists: Any,
        users: Any,
        rgb: Any,
        segmentation: Any,
    ) -> int:
        """Paints pictures, one after the other; of picture i the road users are rows begins[i] to begins[i + 1]."""
        for i in range(poses.shape[0]):
            frame_into(
                poses[i, 0],
                poses[i, 1],
                poses[i, 2],
                seeds[i],
                ticks[i],
                others[begins[i] : begins[i + 1]],
                camera,
                looks[i],
                ground,
                frame,
                scenery,
                shops,
                cover,
                work,
                place,
                counts,
                lists,
                users,
                rgb[i],
                segmentation[i],
            )
        return version

    return frames_into


frames_into = _compiled(_digest())
