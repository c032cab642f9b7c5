"""Upright faces: houses with windows, walls of bricks, hedges."""

from typing import Any, NamedTuple

from wrongturn_protocol.segmentation import SegmentationClass
from wrongturn_sim.camera import kernels, solids
from wrongturn_sim.camera.kernels import Colour, Column, clamp, floor, grain, kernel, toned, triple
from wrongturn_sim.camera.weathers import HAZE_COLOUR, HORIZON, LAMPS, SKYLIGHT, SUN, SUNLIGHT

_BUILDING = int(SegmentationClass.BUILDING)
_WALL = int(SegmentationClass.WALL)
_VEGETATION = int(SegmentationClass.VEGETATION)


class Face(NamedTuple):
    """The place where a column meets an upright face."""

    t: float
    """Depth, metres."""
    s: float
    """Metres along the face from its middle."""
    along_x: bool
    """Whether the face's normal is the local x axis."""
    tilt: float
    """Cosine of the angle between the rays on the flat and the normal."""
    sun: float
    """Share of the sun that the face gets, 0 to 1."""


class House(NamedTuple):
    """What the rows of a house's face have in common in one column, read before any pixel is written.

    For all that the compiler knows, a written pixel might be part of the arrays that this comes from.
    """

    wall: Colour
    trim: Colour
    eaves: float
    """Height, metres."""
    storey: float
    """Height of each floor, metres."""
    cornice: float
    """Height above which there is a cornice, metres."""
    brick: bool
    base: float
    """How bright the wall is."""
    texture: float
    """How much the brightness of bricks or plaster varies at this distance."""
    seed: int
    sill: float
    """Lower edge of the windows, as a share of the floor's height."""
    lid: float
    """Upper edge."""
    bay: int
    """Number of the bay. Each bay has one window on each floor."""
    door: bool
    """Whether the door is in this bay."""
    shop: int
    """Number of the shop on the ground floor, from 1; 0 where there is none."""
    panes: float
    """The part of a pixel's width that is glass, 0 to 1."""
    frames: float
    """The part that is glass or its frame."""
    bars: float
    """The part that is a bar in the middle of a window."""


@kernel
def pulse(x: float, low: float, high: float) -> float:
    """Return the integral from 0 to x of a wave of period 1 that is 1 from low to high in each period, else 0."""
    whole = floor(x)
    return whole * (high - low) + clamp(x - whole - low, 0.0, high - low)


@kernel
def covered(x: float, step: float, low: float, high: float) -> float:
    """Return the mean of the wave of :func:`pulse` over a range of length ``step`` around x."""
    return (pulse(x + step / 2, low, high) - pulse(x - step / 2, low, high)) / step


@kernel
def overlap(up: float, down: float, low: float, high: float) -> float:
    """Return the length that the range from down to up has in common with the range from low to high."""
    return min(max(up, low), high) - min(max(down, low), high)


@kernel
def lit(row: Any, along_x: bool, sign: float, look: Any) -> float:
    """Return the sun's share on a face, 0 to 1, whose normal is the local x or y axis times the sign."""
    facing_x, facing_y = kernels.turned(row, look[SUN], look[SUN + 1])
    return max(0.0, sign * (facing_x if along_x else facing_y))


@kernel
def house_of(face: Face, foot: float, row: Any) -> House:
    """Return what a column shows of a house's face; ``foot`` is the height of a pixel there, metres."""
    t, s = face.t, face.s
    bay, half = (row[solids.BAY_Y], row[solids.HALF_Y]) if face.along_x else (row[solids.BAY_X], row[solids.HALF_X])
    brick = row[solids.STYLE] == solids.BRICK_STYLE and t < 45.0
    corner = clamp((half - abs(s)) * 2.0, 0.0, 1.0)
    sill = 0.30 + 0.1 * (0.5 - row[solids.TALL])
    x = (s + half) / bay
    step = foot / max(0.2, face.tilt) / bay
    wide, rim = 0.5 * row[solids.WIDE], 0.07 / bay
    bars = covered(x, step, 0.48, 0.52)
    place = floor(x)
    return House(
        triple(row, solids.R),
        triple(row, solids.R2),
        row[solids.HEIGHT],
        row[solids.STOREY],
        row[solids.HEIGHT] - 0.3 if row[solids.RISE] == 0.0 else 1e9,
        brick,
        0.92 + 0.08 * corner,
        0.24 * clamp(1.0 - t / 45.0, 0.0, 1.0) if brick else 0.16 * clamp(1.0 - t / 70.0, 0.0, 1.0),
        int(row[solids.SEED]),
        sill,
        min(0.92, sill + row[solids.TALL]),
        place,
        not face.along_x and place == int(2 * half / bay + 0.5) // 2,
        int(row[solids.SHOP]) if not face.along_x else 0,
        covered(x, step, 0.5 - wide, 0.5 + wide) - bars,
        covered(x, step, 0.5 - wide - rim, 0.5 + wide + rim),
        bars,
    )


@kernel
def wall_colour(house: House, s: float, z: float, y: float, level: int) -> Colour:
    """Return a wall's colour s metres along the face and z metres, or y floors, above the ground."""
    if house.brick:
        course = floor(z * 6.0)
        tone = house.base + house.texture * (grain(floor(s * 2.6 + 0.5 * (course & 1)), course, house.seed) - 0.5)
    else:
        tone = house.base + house.texture * (grain(floor(s * 3.0), floor(z * 3.0), house.seed) - 0.5)
    # Splashed at the foot, and in soft shade under the eaves.
    if z < 0.6:
        tone *= 0.74 + 0.2 * max(z, 0.0)
    elif z > house.eaves - 0.45 and z <= house.eaves:
        tone *= 0.8
    colour = toned(house.wall, tone)
    if z > house.cornice:
        colour = toned(house.trim, 0.94)
    elif level > 0 and (y - level) * house.storey < 0.16:
        # A string course at each floor.
        colour = toned(colour, 1.1)
    return colour


@kernel
def window_height(house: House, z: float, y: float, level: int, foot: float) -> tuple[float, float]:
    """Return the parts of a pixel's height that are glass, and glass or its frame."""
    if z > house.eaves:
        return 0.0, 0.0
    bottom, top, edge = house.sill, house.lid, 0.06 / house.storey
    if level == 0 and (house.door or house.shop > 0):
        bottom, top = 0.02, 0.72
    part, per_part = foot * (1.0 / house.storey), house.storey / foot
    up, down = y + part / 2 - level, y - part / 2 - level
    glass = overlap(up, down, bottom, top) * per_part
    return glass, overlap(up, down, bottom - edge, top + edge) * per_part


@kernel
def glass_colour(house: House, level: int, sky: Colour) -> Colour:
    """Return the colour of a window without a lamp: it mirrors the sky or has a curtain."""
    chance = kernels.noise(house.bay, level, house.seed + 1)
    pale = 0.35 + 0.45 * chance
    red = 26.0 + 0.30 * pale * sky[0]
    green = 32.0 + 0.31 * pale * sky[1]
    blue = 38.0 + 0.33 * pale * sky[2]
    if chance > 0.82:
        red, green, blue = red * 0.5 + 90.0, green * 0.5 + 84.0, blue * 0.5 + 74.0
    return red, green, blue


@kernel
def with_window(
    house: House, wall: Colour, glass: Colour, z: float, level: int, inside: float, outside: float
) -> Colour:
    """Return the colour of a wall with a window or a door; the last two are those of :func:`window_height`."""
    cover, inner = house.frames * outside, house.panes * inside
    if level == 0 and house.shop > 0:
        dim = 0.5 + 0.5 * clamp((z - 0.5) * 2.0, 0.0, 1.0)
        cover, inner = outside, inside * dim * (1.0 - house.bars)
    rest = 1.0 - cover
    if level == 0 and house.door and house.shop == 0:
        # The leaf of a door has the trim's colour.
        red = wall[0] * rest + (0.45 * house.trim[0] + 20.0) * cover
        green = wall[1] * rest + (0.45 * house.trim[1] + 16.0) * cover
        blue = wall[2] * rest + (0.45 * house.trim[2] + 12.0) * cover
    else:
        frame = max(cover - inner, 0.0)
        red = wall[0] * rest + 222.0 * frame + glass[0] * inner
        green = wall[1] * rest + 219.0 * frame + glass[1] * inner
        blue = wall[2] * rest + 212.0 * frame + glass[2] * inner
    return red, green, blue


@kernel
def house_run(column: Column, a: int, b: int, face: Face, row: Any, shops: Any) -> None:
    """Paint rows a to b of a house's face."""
    t, sun, look = face.t, face.sun, column.look
    foot = t / column.focal
    house = house_of(face, foot, row)
    haze = kernels.haze_at(t, look)
    clear = 1.0 - haze
    sky, lamps = triple(look, HORIZON), look[LAMPS]
    skylight, sunlight, fade = triple(look, SKYLIGHT), triple(look, SUNLIGHT), triple(look, HAZE_COLOUR)
    light_r = (skylight[0] + sun * sunlight[0]) * clear
    light_g = (skylight[1] + sun * sunlight[1]) * clear
    light_b = (skylight[2] + sun * sunlight[2]) * clear
    haze_r, haze_g, haze_b = fade[0] * haze, fade[1] * haze, fade[2] * haze
    per_storey = 1.0 / house.storey
    glazed, glass = -1000, (0.0, 0.0, 0.0)
    for v in range(a, b):
        z = column.eye + column.slopes[v] * t
        y = z * per_storey
        level = floor(y)
        colour = wall_colour(house, face.s, z, y, level)
        inside, outside = window_height(house, z, y, level, foot)
        if outside > 0.0:
            if level != glazed:
                glazed, glass = level, glass_colour(house, level, sky)
                if kernels.noise(house.bay, level, house.seed + 2) < lamps:
                    # A lamp inside does not depend on the light outside.
                    glass = (250.0 / light_r * clear, 196.0 / light_g * clear, 110.0 / light_b * clear)
            colour = with_window(house, colour, glass, z, level, inside, outside)
        if house.shop > 0 and level == 0 and y > 0.76 and y < 0.96:
            colour = triple(shops[house.shop - 1], 0)
        colour = colour[0] * light_r + haze_r, colour[1] * light_g + haze_g, colour[2] * light_b + haze_b
        kernels.put(column, v, colour, _BUILDING)


@kernel
def brick_tone(s: float, z: float, t: float, near: float, height: float, seed: int) -> float:
    """Return how bright a wall of bricks is, s metres along it and z metres above the ground, at distance t."""
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
    return tone


@kernel
def hedge_tone(s: float, z: float, near: float, height: float, seed: int) -> float:
    """Return how bright a hedge is, s metres along it and z metres above the ground."""
    leaf = grain(floor(s * 5.0), floor(z * 5.0), seed)
    bush = grain(floor(s * 1.3), floor(z * 1.6), seed + 3)
    return (0.58 + 0.42 * clamp(z / height, 0.0, 1.0)) * (0.9 + near * 0.55 * (leaf - 0.45) + 0.2 * bush)


@kernel
def wall_run(column: Column, a: int, b: int, t: float, s: float, sun: float, row: Any) -> None:
    """Paint rows a to b of a wall of bricks or of a hedge, at depth t and s metres along it."""
    haze = kernels.haze_at(t, column.look)
    height, seed, kind = row[solids.HEIGHT], int(row[solids.SEED]), int(row[solids.KIND])
    near = clamp(1.0 - t / 60.0, 0.0, 1.0)
    for v in range(a, b):
        z = column.eye + column.slopes[v] * t
        if kind == solids.WALL:
            tone, seen = brick_tone(s, z, t, near, height, seed), _WALL
        else:
            tone, seen = hedge_tone(s, z, near, height, seed), _VEGETATION
        kernels.put_toned(column, v, row, solids.R, tone, sun, haze, seen)


@kernel
def top_pixel(column: Column, v: int, t: float, x: float, y: float, sun: float, row: Any) -> None:
    """Paint a pixel of a roof, a coping or a hedge's crown; (x, y) is its place in the solid's own frame."""
    haze = kernels.haze_at(t, column.look)
    near = clamp(1.0 - t / 70.0, 0.0, 1.0)
    seed, kind = int(row[solids.SEED]), int(row[solids.KIND])
    first, seen, tone = solids.R, _WALL, 1.1
    if kind == solids.HEDGE:
        seen, tone = _VEGETATION, 0.95 + near * 0.5 * (grain(floor(x * 5.0), floor(y * 5.0), seed) - 0.45)
    elif kind != solids.WALL:
        tiles = grain(floor(x * 2.5), floor(y * 3.0), seed)
        first, seen, tone = solids.R2, _BUILDING, 0.95 + near * 0.22 * (tiles - 0.5)
    kernels.put_toned(column, v, row, first, tone, sun, haze, seen)
