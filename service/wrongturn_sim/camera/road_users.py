"""Cars and people: tapered boxes with wheels, glass and lamps; a figure on legs."""

import math
from typing import Any

from wrongturn_protocol import SegmentationClass
from wrongturn_sim.camera.kernels import clamp, first_row, floor, haze_at, kernel, noise, put
from wrongturn_sim.camera.solids import (
    B2,
    BOUND,
    CAR,
    COS,
    G2,
    HALF_X,
    HALF_Y,
    HEIGHT,
    KIND,
    R2,
    SEED,
    SIN,
    WALKER,
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
    HORIZON_B,
    HORIZON_G,
    HORIZON_R,
    SKYLIGHT_B,
    SKYLIGHT_G,
    SKYLIGHT_R,
    SUN_X,
    SUN_Y,
    SUN_Z,
    SUNLIGHT_B,
    SUNLIGHT_G,
    SUNLIGHT_R,
    ZENITH_B,
    ZENITH_G,
    ZENITH_R,
)

_VEHICLE = int(SegmentationClass.VEHICLE)
_PEDESTRIAN = int(SegmentationClass.PEDESTRIAN)

WHEEL = 0.32
"""Its radius, metres."""
SILL = 0.26
"""Height of a car's lower edge above the ground, metres."""


@kernel
def row_of_other(other: Any, row: Any) -> None:
    """Turns a road user (x, y, yaw, length, width, height, kind, colour) into a row of a solid."""
    row[X], row[Y] = other[0], other[1]
    row[COS], row[SIN] = math.cos(other[2]), math.sin(other[2])
    row[HALF_X], row[HALF_Y], row[HEIGHT] = 0.5 * other[3], 0.5 * other[4], other[5]
    row[BOUND] = math.sqrt(row[HALF_X] * row[HALF_X] + row[HALF_Y] * row[HALF_Y]) + 0.3
    colour = int(other[7])
    row[SEED] = colour & 0xFFFF
    row[KIND] = CAR if other[6] < 0.5 else WALKER
    pick = int(noise(colour, 3, 1) * 9.999)
    red, green, blue = 176.0, 30.0, 34.0
    if pick == 1:
        red, green, blue = 232.0, 232.0, 230.0
    elif pick == 2:
        red, green, blue = 40.0, 42.0, 48.0
    elif pick == 3:
        red, green, blue = 150.0, 156.0, 164.0
    elif pick == 4:
        red, green, blue = 34.0, 70.0, 140.0
    elif pick == 5:
        red, green, blue = 214.0, 166.0, 40.0
    elif pick == 6:
        red, green, blue = 40.0, 104.0, 70.0
    elif pick == 7:
        red, green, blue = 92.0, 132.0, 168.0
    elif pick == 8:
        red, green, blue = 198.0, 98.0, 40.0
    elif pick == 9:
        red, green, blue = 110.0, 92.0, 78.0
    row[R], row[G], row[B] = red, green, blue
    legs = 40.0 + 60.0 * noise(colour, 5, 2)
    row[R2], row[G2], row[B2] = legs, legs, legs * 1.25


@kernel
def into(
    x: float,
    y: float,
    z: float,
    dx: float,
    dy: float,
    dz: float,
    half_x: float,
    half_y: float,
    low: float,
    high: float,
    front: float,
    back: float,
    side: float,
) -> tuple[float, int]:
    """Where a ray enters a box whose sides lean inwards (metres for each metre of height), and through which face.

    Faces: 0 front, 1 back, 2 left, 3 right, 4 top, 5 bottom; distance below 0: it misses.
    """
    first, last, face = -1e9, 1e9, -1
    rise = z - low
    for plane in range(6):
        if plane == 0:
            gap, rate = half_x - x - front * rise, dx + front * dz
        elif plane == 1:
            gap, rate = half_x + x - back * rise, -dx + back * dz
        elif plane == 2:
            gap, rate = half_y - y - side * rise, dy + side * dz
        elif plane == 3:
            gap, rate = half_y + y - side * rise, -dy + side * dz
        elif plane == 4:
            gap, rate = high - z, dz
        else:
            gap, rate = rise, -dz
        if rate < 0.0:
            t = gap / rate
            if t > first:
                first, face = t, plane
        elif rate > 0.0:
            t = gap / rate
            last = min(last, t)
        elif gap < 0.0:
            return -1.0, -1
    if first >= last:
        return -1.0, -1
    return first, face


@kernel
def shade_below(
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
    slopes: Any,
    shade: Any,
) -> None:
    """Darkens the ground below a road user."""
    ldx, ldy = row[COS] * dx + row[SIN] * dy, row[COS] * dy - row[SIN] * dx
    margin = 0.12
    t, _ = into(rx, ry, 0.5, ldx, ldy, 0.0, row[HALF_X] + margin, row[HALF_Y] + margin, 0.0, 1.0, 0.0, 0.0, 0.0)
    if t <= 0.2:
        return
    back, _ = into(
        rx + 1e3 * ldx,
        ry + 1e3 * ldy,
        0.5,
        -ldx,
        -ldy,
        0.0,
        row[HALF_X] + margin,
        row[HALF_Y] + margin,
        0.0,
        1.0,
        0.0,
        0.0,
        0.0,
    )
    a = first_row(-eye / (1e3 - back), v0, v1, focal, cy, slopes)
    b = first_row(-eye / t, v0, v1, focal, cy, slopes)
    for v in range(a, b):
        shade[v] *= 0.42


@kernel
def car(
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
    """Paints a vehicle where it is the nearest."""
    ldx, ldy = row[COS] * dx + row[SIN] * dy, row[COS] * dy - row[SIN] * dx
    half_x, half_y, height = row[HALF_X], row[HALF_Y], row[HEIGHT]
    nearest, _ = into(rx, ry, 0.5, ldx, ldy, 0.0, half_x, half_y, 0.0, 1.0, 0.0, 0.0, 0.0)
    above = height < eye and abs(rx) < half_x and abs(ry) < half_y
    if nearest <= 0.2 and not above:
        return
    # Of what is lower than the camera the top is seen too.
    a = first_row(0.0 if height < eye else (height - eye) / nearest, v0, v1, focal, cy, slopes)
    b = v1 if above else first_row(-eye / nearest, v0, v1, focal, cy, slopes)
    tall = height > 2.1
    belt = 0.5 * height if tall else 0.58 * height
    cabin_half = half_x * (0.985 if tall else 0.60)
    shift = 0.0 if tall else 0.10 * half_x
    front, rear, side = (0.12, 0.02, 0.03) if tall else (0.75, 0.45, 0.22)
    haze = haze_at(0.0 if above else nearest, look)
    clear = 1.0 - haze
    sun_x = row[COS] * look[SUN_X] + row[SIN] * look[SUN_Y]
    sun_y = row[COS] * look[SUN_Y] - row[SIN] * look[SUN_X]
    axle = 0.60 * half_x
    for v in range(a, b):
        slope = slopes[v]
        t, face = into(rx, ry, eye, ldx, ldy, slope, half_x, half_y, SILL, belt, 0.10, 0.06, 0.05)
        cabin = False
        t2, face2 = into(
            rx + shift, ry, eye, ldx, ldy, slope, cabin_half, half_y * 0.96, belt, height, front, rear, side
        )
        if t2 > 0.0 and (t <= 0.0 or t2 < t):
            t, face, cabin = t2, face2, True
        red, green, blue = row[R], row[G], row[B]
        gloss = 0.0
        if t <= 0.0 or (face == 5 and not cabin):
            # Below the sill there are wheels.
            t, face = into(rx, ry, eye, ldx, ldy, slope, half_x * 0.97, half_y * 0.97, 0.0, SILL + 0.1, 0.0, 0.0, 0.0)
            if t <= 0.0:
                continue
            x, y, z = rx + t * ldx, ry + t * ldy, eye + t * slope
            if 1 < face < 4:
                off = abs(x) - axle
                if off * off + (z - WHEEL) * (z - WHEEL) > WHEEL * WHEEL:
                    continue
            elif 0 <= face < 2:
                if abs(y) < half_y - 0.24:
                    continue
            else:
                continue
            red = green = blue = 26.0
            facing = 0.0
        else:
            x, y, z = rx + t * ldx, ry + t * ldy, eye + t * slope
            if face == 0:
                facing = sun_x + (0.5 * look[SUN_Z] if cabin else 0.0)
            elif face == 1:
                facing = -sun_x + (0.3 * look[SUN_Z] if cabin else 0.0)
            elif face == 2:
                facing = sun_y
            elif face == 3:
                facing = -sun_y
            else:
                facing = look[SUN_Z]
            if cabin:
                x += shift
                part = (z - belt) / (height - belt)
                if face < 4 and part > 0.10 and part < 0.88:
                    lean = front if face == 0 else rear
                    width = (half_y * 0.96 - side * (z - belt)) if face < 2 else (cabin_half - lean * (z - belt))
                    across = abs(y) if face < 2 else abs(x)
                    pillar = face >= 2 and abs(x - 0.02) < 0.06
                    if across < width - 0.10 and not pillar and not (tall and face >= 2 and x < half_x * 0.35):
                        red, green, blue = 24.0, 28.0, 33.0
                        gloss = 0.16 + 0.30 * part
            elif face == 0:
                if z > 0.52 * belt and z < 0.86 * belt and abs(y) > half_y * 0.60:
                    red, green, blue = 250.0, 248.0, 232.0
                elif z < 0.62 * belt and abs(y) < half_y * 0.55:
                    red, green, blue = 30.0, 30.0, 32.0
            elif face == 1:
                if z > 0.60 * belt and z < 0.90 * belt and abs(y) > half_y * 0.62:
                    red, green, blue = 206.0, 22.0, 20.0
                elif abs(y) < 0.27 and z > 0.48 * belt and z < 0.62 * belt:
                    red, green, blue = 226.0, 226.0, 214.0
                elif z < 0.42 * belt:
                    red, green, blue = red * 0.45, green * 0.45, blue * 0.45
            elif 1 < face < 4:
                off = abs(x) - axle
                arch = off * off + (z - WHEEL) * (z - WHEEL)
                if arch < WHEEL * WHEEL:
                    red = green = blue = 118.0 if arch < 0.03 else 26.0
                elif arch < 0.16:
                    red, green, blue = red * 0.35, green * 0.35, blue * 0.35
                elif z < 0.36:
                    red, green, blue = red * 0.5, green * 0.5, blue * 0.5
                elif abs(x - 0.1 * half_x) < 0.025 or abs(abs(x) - 0.42 * half_x) < 0.02:
                    red, green, blue = red * 0.7, green * 0.7, blue * 0.7
            elif face == 4:
                gloss = 0.22
        if t >= depth[v] or t <= 0.2:
            continue
        depth[v] = t
        sun = clamp(facing, 0.0, 1.0)
        red, green, blue = (
            red * (0.9 * look[SKYLIGHT_R] + sun * look[SUNLIGHT_R]),
            green * (0.9 * look[SKYLIGHT_G] + sun * look[SUNLIGHT_G]),
            blue * (0.9 * look[SKYLIGHT_B] + sun * look[SUNLIGHT_B]),
        )
        red += (0.5 * (look[HORIZON_R] + look[ZENITH_R]) - red) * gloss
        green += (0.5 * (look[HORIZON_G] + look[ZENITH_G]) - green) * gloss
        blue += (0.5 * (look[HORIZON_B] + look[ZENITH_B]) - blue) * gloss
        put(
            canvas,
            u,
            v,
            red * clear + look[HAZE_R] * haze,
            green * clear + look[HAZE_G] * haze,
            blue * clear + look[HAZE_B] * haze,
            _VEHICLE,
        )


@kernel
def walker(
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
    """Paints a pedestrian where they are the nearest: a figure that always faces the camera."""
    ox, oy = row[X] - px, row[Y] - py
    away = ox * ox + oy * oy
    # The figure stands on the plane across the line to it.
    t = away / max(dx * ox + dy * oy, 1e-6)
    if t <= 0.3 or t > 1e3:
        return
    aside = (t * (dx * oy - dy * ox)) / math.sqrt(away)
    width = clamp(row[HALF_Y], 0.2, 0.4)
    if abs(aside) > width:
        return
    height = row[HEIGHT]
    a = first_row((height - eye) / t, v0, v1, focal, cy, slopes)
    b = first_row(-eye / t, v0, v1, focal, cy, slopes)
    haze = haze_at(t, look)
    clear = 1.0 - haze
    # A stride that goes with the way that was walked.
    phase = (row[X] * row[COS] + row[Y] * row[SIN]) * 1.3
    stride = 0.25 + 0.75 * abs(2.0 * (phase - floor(phase)) - 1.0)
    for v in range(a, b):
        if t >= depth[v]:
            continue
        y = (eye + slopes[v] * t) / height
        across = abs(aside) / width
        if y > 0.86:
            # The head is a disc.
            up = (y - 0.93) * height
            if up * up + aside * aside > 0.0145:
                continue
            red, green, blue = (70.0, 52.0, 40.0) if y > 0.945 else (206.0, 160.0, 132.0)
        elif y > 0.48:
            if across > (0.55 if y > 0.83 else 0.98):
                continue
            shade = 0.8 if across > 0.68 else 1.0
            red, green, blue = row[R] * shade, row[G] * shade, row[B] * shade
            if across > 0.68 and y < 0.53:
                red, green, blue = 206.0, 160.0, 132.0
        else:
            spread = stride * (0.48 - y) * 1.1
            if across < spread - 0.06 or across > spread + 0.46:
                continue
            red, green, blue = row[R2], row[G2], row[B2]
            if y < 0.05:
                red = green = blue = 30.0
        depth[v] = t
        sun = 0.6 if aside > 0.0 else 0.35
        put(
            canvas,
            u,
            v,
            red * (look[SKYLIGHT_R] + sun * look[SUNLIGHT_R]) * clear + look[HAZE_R] * haze,
            green * (look[SKYLIGHT_G] + sun * look[SUNLIGHT_G]) * clear + look[HAZE_G] * haze,
            blue * (look[SKYLIGHT_B] + sun * look[SUNLIGHT_B]) * clear + look[HAZE_B] * haze,
            _PEDESTRIAN,
        )
