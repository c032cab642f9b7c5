"""Upright faces: houses with windows, walls of bricks, hedges, fences."""

from typing import Any

from wrongturn_protocol import SegmentationClass
from wrongturn_sim.camera.kernels import clamp, floor, grain, haze_at, kernel, noise, put
from wrongturn_sim.camera.solids import (
    B2,
    BAY_X,
    BAY_Y,
    COS,
    G2,
    HALF_X,
    HALF_Y,
    HEDGE,
    HEIGHT,
    R2,
    RISE,
    SEED,
    SHOP,
    SIN,
    STOREY,
    STYLE,
    TALL,
    WALL,
    WIDE,
    B,
    G,
    R,
)
from wrongturn_sim.camera.weathers import (
    HAZE_B,
    HAZE_G,
    HAZE_R,
    HORIZON_B,
    HORIZON_G,
    HORIZON_R,
    LAMPS,
    SKYLIGHT_B,
    SKYLIGHT_G,
    SKYLIGHT_R,
    SUN_X,
    SUN_Y,
    SUNLIGHT_B,
    SUNLIGHT_G,
    SUNLIGHT_R,
)

_BUILDING = int(SegmentationClass.BUILDING)
_WALL = int(SegmentationClass.WALL)
_VEGETATION = int(SegmentationClass.VEGETATION)


@kernel
def pulse(x: float, low: float, high: float) -> float:
    """Integral from 0 to x of what is 1 between low and high of each whole step, else 0."""
    whole = floor(x)
    return whole * (high - low) + clamp(x - whole - low, 0.0, high - low)


@kernel
def lit(row: Any, along_x: bool, sign: float, look: Any) -> float:
    """How far the sun shines on a face, 0 to 1: its normal is the local x or y axis, times the sign."""
    if along_x:
        facing: float = row[COS] * look[SUN_X] + row[SIN] * look[SUN_Y]
    else:
        facing = row[COS] * look[SUN_Y] - row[SIN] * look[SUN_X]
    return max(0.0, sign * facing)


@kernel
def house_run(
    u: int,
    a: int,
    b: int,
    t: float,
    tilt: float,
    s: float,
    along_x: bool,
    sun: float,
    eye: float,
    focal: float,
    row: Any,
    look: Any,
    slopes: Any,
    shops: Any,
    canvas: Any,
) -> None:
    """Paints rows a to b of a house's face at distance t; s: metres from the middle of the face."""
    foot = t / focal
    eaves, storey, seed = row[HEIGHT], row[STOREY], int(row[SEED])
    bay, half = (row[BAY_Y], row[HALF_Y]) if along_x else (row[BAY_X], row[HALF_X])
    step = foot / max(0.2, tilt) / bay
    x = (s + half) / bay
    wide, tall = 0.5 * row[WIDE], row[TALL]
    rim = 0.07 / bay
    panes = (pulse(x + step / 2, 0.5 - wide, 0.5 + wide) - pulse(x - step / 2, 0.5 - wide, 0.5 + wide)) / step
    low, high = 0.5 - wide - rim, 0.5 + wide + rim
    frames = (pulse(x + step / 2, low, high) - pulse(x - step / 2, low, high)) / step
    # A bar in the middle of the window, where it is near enough to be seen.
    bars = (pulse(x + step / 2, 0.48, 0.52) - pulse(x - step / 2, 0.48, 0.52)) / step
    panes -= bars
    place = floor(x)
    bays = int(2 * half / bay + 0.5)
    door = not along_x and place == bays // 2
    shop = int(row[SHOP]) if not along_x else 0
    sill = 0.30 + 0.1 * (0.5 - tall)
    lid = min(0.92, sill + tall)
    edge_z = 0.06 / storey
    haze = haze_at(t, look)
    clear = 1.0 - haze
    light_r = (look[SKYLIGHT_R] + sun * look[SUNLIGHT_R]) * clear
    light_g = (look[SKYLIGHT_G] + sun * look[SUNLIGHT_G]) * clear
    light_b = (look[SKYLIGHT_B] + sun * look[SUNLIGHT_B]) * clear
    haze_r, haze_g, haze_b = look[HAZE_R] * haze, look[HAZE_G] * haze, look[HAZE_B] * haze
    rough = 0.16 * clamp(1.0 - t / 70.0, 0.0, 1.0)
    brick = row[STYLE] == 1.0 and t < 45.0
    mortar = 0.24 * clamp(1.0 - t / 45.0, 0.0, 1.0)
    per_storey = 1.0 / storey
    part = foot * per_storey
    per_part = storey / foot
    column = floor(s * 3.0)
    corner = clamp((half - abs(s)) * 2.0, 0.0, 1.0)
    base = 0.92 + 0.08 * corner
    above = -1000
    glass_r = glass_g = glass_b = 0.0
    # Read once: a written pixel might be part of any of them, for all that the compiler knows.
    wall_r, wall_g, wall_b = row[R], row[G], row[B]
    trim_r, trim_g, trim_b = row[R2], row[G2], row[B2]
    sky_r, sky_g, sky_b, lamps = look[HORIZON_R], look[HORIZON_G], look[HORIZON_B], look[LAMPS]
    cornice = eaves - 0.3 if row[RISE] == 0.0 else 1e9
    shaded = eaves - 0.45
    for v in range(a, b):
        z = eye + slopes[v] * t
        y = z * per_storey
        level = floor(y)
        if z > eaves:
            share_in = share_out = 0.0
        else:
            bottom = sill
            top = lid
            if level == 0 and (door or shop > 0):
                bottom, top = 0.02, 0.72
            up, down = y + part / 2 - level, y - part / 2 - level
            share_in = (min(max(up, bottom), top) - min(max(down, bottom), top)) * per_part
            share_out = (
                min(max(up, bottom - edge_z), top + edge_z) - min(max(down, bottom - edge_z), top + edge_z)
            ) * per_part
        if brick:
            course = floor(z * 6.0)
            stretch = s * 2.6 + 0.5 * (course & 1)
            tone = base + mortar * (grain(floor(stretch), course, seed) - 0.5)
        else:
            tone = base + rough * (grain(column, floor(z * 3.0), seed) - 0.5)
        # Splashed foot, and the soft shade under the eaves.
        if z < 0.6:
            tone *= 0.74 + 0.2 * max(z, 0.0)
        elif z > shaded and z <= eaves:
            tone *= 0.8
        red, green, blue = wall_r * tone, wall_g * tone, wall_b * tone
        if z > cornice:
            red, green, blue = trim_r * 0.94, trim_g * 0.94, trim_b * 0.94
        elif level > 0 and (y - level) * storey < 0.16:
            # A string course at each floor.
            red, green, blue = red * 1.1, green * 1.1, blue * 1.1
        if share_out > 0.0:
            if level != above:
                above = level
                chance = noise(place, level, seed + 1)
                pale = 0.35 + 0.45 * chance
                glass_r = 26.0 + 0.30 * pale * sky_r
                glass_g = 32.0 + 0.31 * pale * sky_g
                glass_b = 38.0 + 0.33 * pale * sky_b
                if chance > 0.82:
                    glass_r, glass_g, glass_b = glass_r * 0.5 + 90.0, glass_g * 0.5 + 84.0, glass_b * 0.5 + 74.0
                if noise(place, level, seed + 2) < lamps:
                    # A lamp within owes nothing to the light outside.
                    glass_r, glass_g, glass_b = 250.0 / light_r, 196.0 / light_g, 110.0 / light_b
                    glass_r, glass_g, glass_b = glass_r * clear, glass_g * clear, glass_b * clear
            cover, inner = frames * share_out, panes * share_in
            if level == 0 and shop > 0:
                inside = 0.5 + 0.5 * clamp((z - 0.5) * 2.0, 0.0, 1.0)
                cover, inner = share_out, share_in * inside * (1.0 - bars)
            if level == 0 and door and shop == 0:
                # The leaf of a door has the trim's colour.
                red = red * (1.0 - cover) + (0.45 * trim_r + 20.0) * cover
                green = green * (1.0 - cover) + (0.45 * trim_g + 16.0) * cover
                blue = blue * (1.0 - cover) + (0.45 * trim_b + 12.0) * cover
            else:
                rest = 1.0 - cover
                edge = max(cover - inner, 0.0)
                red = red * rest + 222.0 * edge + glass_r * inner
                green = green * rest + 219.0 * edge + glass_g * inner
                blue = blue * rest + 212.0 * edge + glass_b * inner
        if shop > 0 and level == 0 and y > 0.76 and y < 0.96:
            red, green, blue = shops[shop - 1, 0], shops[shop - 1, 1], shops[shop - 1, 2]
        put(
            canvas,
            u,
            v,
            red * light_r + haze_r,
            green * light_g + haze_g,
            blue * light_b + haze_b,
            _BUILDING,
        )


@kernel
def wall_run(
    u: int,
    a: int,
    b: int,
    t: float,
    s: float,
    sun: float,
    eye: float,
    row: Any,
    kind: int,
    look: Any,
    slopes: Any,
    canvas: Any,
) -> None:
    """Paints rows a to b of a wall of bricks or of a hedge."""
    haze = haze_at(t, look)
    clear = 1.0 - haze
    light_r = (look[SKYLIGHT_R] + sun * look[SUNLIGHT_R]) * clear
    light_g = (look[SKYLIGHT_G] + sun * look[SUNLIGHT_G]) * clear
    light_b = (look[SKYLIGHT_B] + sun * look[SUNLIGHT_B]) * clear
    height, seed = row[HEIGHT], int(row[SEED])
    near = clamp(1.0 - t / 60.0, 0.0, 1.0)
    for v in range(a, b):
        z = eye + slopes[v] * t
        if kind == WALL:
            course = floor(z * 4.0)
            stretch = s * 2.0 + 0.5 * (course & 1)
            stone = floor(stretch)
            tone = 0.92 + near * 0.24 * (grain(int(stone), course, seed) - 0.5)
            if t < 22.0 and (stretch - stone < 0.07 or z * 4.0 - course < 0.13):
                tone *= 1.0 - 0.25 * clamp(1.6 - t / 14.0, 0.0, 1.0)
            if z > height - 0.14:
                tone *= 1.14
            elif z > height - 0.22:
                tone *= 0.8
            tone *= 0.8 + 0.2 * clamp(z * 2.0, 0.0, 1.0)
            seen = _WALL
        else:
            leaf = grain(floor(s * 5.0), floor(z * 5.0), seed)
            bush = grain(floor(s * 1.3), floor(z * 1.6), seed + 3)
            tone = (0.58 + 0.42 * clamp(z / height, 0.0, 1.0)) * (0.9 + near * 0.55 * (leaf - 0.45) + 0.2 * bush)
            seen = _VEGETATION
        put(
            canvas,
            u,
            v,
            row[R] * tone * light_r + look[HAZE_R] * haze,
            row[G] * tone * light_g + look[HAZE_G] * haze,
            row[B] * tone * light_b + look[HAZE_B] * haze,
            seen,
        )


@kernel
def top_pixel(
    u: int,
    v: int,
    t: float,
    x: float,
    y: float,
    row: Any,
    kind: int,
    sun: float,
    look: Any,
    canvas: Any,
) -> None:
    """A pixel of what lies on top: a roof, a coping, a hedge's crown; x, y: local, metres."""
    haze = haze_at(t, look)
    clear = 1.0 - haze
    near = clamp(1.0 - t / 70.0, 0.0, 1.0)
    seed = int(row[SEED])
    if kind == HEDGE:
        tone = 0.95 + near * 0.5 * (grain(floor(x * 5.0), floor(y * 5.0), seed) - 0.45)
        red, green, blue, seen = row[R] * tone, row[G] * tone, row[B] * tone, _VEGETATION
    elif kind == WALL:
        tone = 1.1
        red, green, blue, seen = row[R] * tone, row[G] * tone, row[B] * tone, _WALL
    else:
        tiles = grain(floor(x * 2.5), floor(y * 3.0), seed)
        tone = 0.95 + near * 0.22 * (tiles - 0.5)
        red, green, blue, seen = row[R2] * tone, row[G2] * tone, row[B2] * tone, _BUILDING
    put(
        canvas,
        u,
        v,
        red * (look[SKYLIGHT_R] + sun * look[SUNLIGHT_R]) * clear + look[HAZE_R] * haze,
        green * (look[SKYLIGHT_G] + sun * look[SUNLIGHT_G]) * clear + look[HAZE_G] * haze,
        blue * (look[SKYLIGHT_B] + sun * look[SUNLIGHT_B]) * clear + look[HAZE_B] * haze,
        seen,
    )
