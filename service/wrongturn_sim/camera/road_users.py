"""Cars and people: tapered boxes with wheels, glass and lamps; a figure on legs."""

import math
from typing import Any, Final, NamedTuple

from wrongturn_protocol.segmentation import SegmentationClass
from wrongturn_sim.camera import kernels
from wrongturn_sim.camera.kernels import Colour, Column, clamp, first_row, kernel, toned, triple, turned
from wrongturn_sim.camera.solids import BOUND, CAR, COS, HALF_X, HALF_Y, HEIGHT, KIND, R2, SEED, SIN, WALKER, R, X, Y
from wrongturn_sim.camera.weathers import HORIZON, SKYLIGHT, SUN, SUNLIGHT, ZENITH

_VEHICLE = int(SegmentationClass.VEHICLE)
_PEDESTRIAN = int(SegmentationClass.PEDESTRIAN)

# Columns of a road user, as the renderer takes it; the yaw in radians, kind 0 for a vehicle and 1 for a pedestrian.
USER_X, USER_Y, USER_YAW, USER_LENGTH, USER_WIDTH, USER_HEIGHT, USER_KIND, USER_COLOUR = range(8)

FRONT, BACK, LEFT, RIGHT, TOP, BOTTOM = range(6)
"""Faces of a box."""

PAINTS: Final = (
    (176.0, 30.0, 34.0),
    (232.0, 232.0, 230.0),
    (40.0, 42.0, 48.0),
    (150.0, 156.0, 164.0),
    (34.0, 70.0, 140.0),
    (214.0, 166.0, 40.0),
    (40.0, 104.0, 70.0),
    (92.0, 132.0, 168.0),
    (198.0, 98.0, 40.0),
    (110.0, 92.0, 78.0),
)
"""Colours of cars and of coats: red, green, blue."""
WHEEL = 0.32
"""Radius of a wheel, metres."""
SILL = 0.26
"""Height of a car's lower edge above the ground, metres."""
CLOSE = 0.2
"""What is nearer than this is not painted, metres."""


class Box(NamedTuple):
    """A box from ``low`` to ``high`` whose sides lean inwards by this many metres for each metre of height."""

    half_x: float
    half_y: float
    low: float
    high: float
    front: float
    back: float
    side: float


class Body(NamedTuple):
    """The shape of a vehicle, metres."""

    half_x: float
    half_y: float
    height: float
    tall: bool
    """Whether it is a van, lorry or bus."""
    belt: float
    """Height of the lower edge of the windows."""
    shift: float
    """How far behind the middle of the vehicle the middle of the cabin is."""
    cabin: Box


class Spot(NamedTuple):
    """A place on a vehicle's surface, in the vehicle's own frame."""

    face: int
    x: float
    y: float
    z: float


@kernel
def row_of_other(other: Any, row: Any) -> None:
    """Write a road user as a solid's row."""
    row[X], row[Y] = other[USER_X], other[USER_Y]
    row[COS], row[SIN] = math.cos(other[USER_YAW]), math.sin(other[USER_YAW])
    row[HALF_X], row[HALF_Y], row[HEIGHT] = 0.5 * other[USER_LENGTH], 0.5 * other[USER_WIDTH], other[USER_HEIGHT]
    row[BOUND] = math.sqrt(row[HALF_X] * row[HALF_X] + row[HALF_Y] * row[HALF_Y]) + 0.3
    colour = int(other[USER_COLOUR])
    row[SEED] = colour & 0xFFFF
    row[KIND] = CAR if other[USER_KIND] < 0.5 else WALKER
    row[R], row[R + 1], row[R + 2] = PAINTS[int(kernels.noise(colour, 3, 1) * 9.999)]
    legs = 40.0 + 60.0 * kernels.noise(colour, 5, 2)
    row[R2], row[R2 + 1], row[R2 + 2] = legs, legs, legs * 1.25


@kernel
def into(x: float, y: float, z: float, dx: float, dy: float, dz: float, box: Box) -> tuple[float, int]:
    """Return the depth at which a ray enters a box, and the face that it enters through; -1, -1 if it misses."""
    first, last, face = -1e9, 1e9, -1
    rise = z - box.low
    for plane in range(6):
        # The distance to the plane of the face, and how fast the ray moves away from it.
        if plane == FRONT:
            gap, rate = box.half_x - x - box.front * rise, dx + box.front * dz
        elif plane == BACK:
            gap, rate = box.half_x + x - box.back * rise, -dx + box.back * dz
        elif plane == LEFT:
            gap, rate = box.half_y - y - box.side * rise, dy + box.side * dz
        elif plane == RIGHT:
            gap, rate = box.half_y + y - box.side * rise, -dy + box.side * dz
        elif plane == TOP:
            gap, rate = box.high - z, dz
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
def into_outline(x: float, y: float, dx: float, dy: float, half_x: float, half_y: float) -> float:
    """Return the depth at which a ray on the flat enters a rectangle; below 0 if it misses."""
    t, _ = into(x, y, 0.5, dx, dy, 0.0, Box(half_x, half_y, 0.0, 1.0, 0.0, 0.0, 0.0))
    return t


@kernel
def shade_below(column: Column, x: float, y: float, row: Any) -> None:
    """Darken the ground below a road user; the camera is at (x, y) in the road user's own frame."""
    dx, dy = turned(row, column.dx, column.dy)
    half_x, half_y = row[HALF_X] + 0.12, row[HALF_Y] + 0.12
    t = into_outline(x, y, dx, dy, half_x, half_y)
    if t <= CLOSE:
        return
    back = into_outline(x + 1e3 * dx, y + 1e3 * dy, -dx, -dy, half_x, half_y)
    a = first_row(-column.eye / (1e3 - back), column)
    b = first_row(-column.eye / t, column)
    for v in range(a, b):
        column.shade[v] *= 0.42


@kernel
def body_of(row: Any) -> Body:
    """Return the shape of a vehicle."""
    half_x, half_y, height = row[HALF_X], row[HALF_Y], row[HEIGHT]
    tall = height > 2.1
    belt = 0.5 * height if tall else 0.58 * height
    half = half_x * (0.985 if tall else 0.60)
    front, rear, side = (0.12, 0.02, 0.03) if tall else (0.75, 0.45, 0.22)
    shift = 0.0 if tall else 0.10 * half_x
    cabin = Box(half, half_y * 0.96, belt, height, front, rear, side)
    return Body(half_x, half_y, height, tall, belt, shift, cabin)


@kernel
def off_wheel(body: Body, x: float, z: float) -> float:
    """Return the square of the distance from the nearest wheel's middle, on the side of a vehicle."""
    off = abs(x) - 0.60 * body.half_x
    return off * off + (z - WHEEL) * (z - WHEEL)


@kernel
def wheel_at(x: float, y: float, z: float, dx: float, dy: float, dz: float, body: Body) -> float:
    """Return the depth at which a ray that passes below the body meets a wheel; below 0 if it meets none."""
    box = Box(body.half_x * 0.97, body.half_y * 0.97, 0.0, SILL + 0.1, 0.0, 0.0, 0.0)
    t, face = into(x, y, z, dx, dy, dz, box)
    if t <= 0.0:
        return -1.0
    if LEFT <= face <= RIGHT:
        return t if off_wheel(body, x + t * dx, z + t * dz) <= WHEEL * WHEEL else -1.0
    if FRONT <= face <= BACK and abs(y + t * dy) >= body.half_y - 0.24:
        return t
    return -1.0


@kernel
def facing_of(face: int, cabin: bool, sun_x: float, sun_y: float, sun_z: float) -> float:
    """Return the cosine of the angle between a face's normal and the sun, in the vehicle's own frame."""
    if face == FRONT:
        return sun_x + (0.5 * sun_z if cabin else 0.0)
    if face == BACK:
        return -sun_x + (0.3 * sun_z if cabin else 0.0)
    if face == LEFT:
        return sun_y
    if face == RIGHT:
        return -sun_y
    return sun_z


@kernel
def glass_gloss(spot: Spot, body: Body) -> float:
    """Return how much of the sky the glass of the cabin mirrors, 0 to 1; below 0 where there is no glass."""
    face, cabin, height = spot.face, body.cabin, spot.z - body.belt
    part = height / (body.height - body.belt)
    if face >= TOP or part <= 0.10 or part >= 0.88:
        return -1.0
    x = spot.x + body.shift
    lean = cabin.front if face == FRONT else cabin.back
    width = (cabin.half_y - cabin.side * height) if face < LEFT else (cabin.half_x - lean * height)
    across = abs(spot.y) if face < LEFT else abs(x)
    pillar = face >= LEFT and abs(x - 0.02) < 0.06
    blind = body.tall and face >= LEFT and x < body.half_x * 0.35
    return 0.16 + 0.30 * part if across < width - 0.10 and not pillar and not blind else -1.0


@kernel
def body_colour(spot: Spot, body: Body, paint: Colour) -> Colour:
    """Return the colour of a vehicle below its windows."""
    z, belt = spot.z, body.belt
    across = abs(spot.y)
    shade = 1.0
    if spot.face == FRONT:
        if z > 0.52 * belt and z < 0.86 * belt and across > body.half_y * 0.60:
            return 250.0, 248.0, 232.0
        if z < 0.62 * belt and across < body.half_y * 0.55:
            return 30.0, 30.0, 32.0
    elif spot.face == BACK:
        if z > 0.60 * belt and z < 0.90 * belt and across > body.half_y * 0.62:
            return 206.0, 22.0, 20.0
        if across < 0.27 and z > 0.48 * belt and z < 0.62 * belt:
            return 226.0, 226.0, 214.0
        if z < 0.42 * belt:
            shade = 0.45
    elif LEFT <= spot.face <= RIGHT:
        arch = off_wheel(body, spot.x, z)
        if arch < WHEEL * WHEEL:
            tyre = 118.0 if arch < 0.03 else 26.0
            return tyre, tyre, tyre
        if arch < 0.16:
            shade = 0.35
        elif z < 0.36:
            shade = 0.5
        elif abs(spot.x - 0.1 * body.half_x) < 0.025 or abs(abs(spot.x) - 0.42 * body.half_x) < 0.02:
            # Gaps around the doors.
            shade = 0.7
    return toned(paint, shade)


@kernel
def car(column: Column, x: float, y: float, row: Any) -> None:
    """Paint a vehicle where it is the nearest; the camera is at (x, y) in the vehicle's own frame."""
    look, eye = column.look, column.eye
    dx, dy = turned(row, column.dx, column.dy)
    body = body_of(row)
    nearest = into_outline(x, y, dx, dy, body.half_x, body.half_y)
    above = body.height < eye and abs(x) < body.half_x and abs(y) < body.half_y
    if nearest <= CLOSE and not above:
        return
    # Of a vehicle that is lower than the camera, the top is seen too.
    a = first_row(0.0 if body.height < eye else (body.height - eye) / nearest, column)
    b = column.v1 if above else first_row(-eye / nearest, column)
    haze = kernels.haze_at(0.0 if above else nearest, look)
    sun_x, sun_y = turned(row, look[SUN], look[SUN + 1])
    lower = Box(body.half_x, body.half_y, SILL, body.belt, 0.10, 0.06, 0.05)
    for v in range(a, b):
        slope = column.slopes[v]
        t, face = into(x, y, eye, dx, dy, slope, lower)
        high, high_face = into(x + body.shift, y, eye, dx, dy, slope, body.cabin)
        cabin = high > 0.0 and (t <= 0.0 or high < t)
        if cabin:
            t, face = high, high_face
        paint = triple(row, R)
        facing = gloss = 0.0
        if t <= 0.0 or (face == BOTTOM and not cabin):
            t = wheel_at(x, y, eye, dx, dy, slope, body)
            paint = 26.0, 26.0, 26.0
        else:
            facing = facing_of(face, cabin, sun_x, sun_y, look[SUN + 2])
            spot = Spot(face, x + t * dx, y + t * dy, eye + t * slope)
            if not cabin:
                paint = body_colour(spot, body, paint)
                gloss = 0.22 if face == TOP else 0.0
            else:
                glass = glass_gloss(spot, body)
                if glass > 0.0:
                    paint, gloss = (24.0, 28.0, 33.0), glass
        if t >= column.depth[v] or t <= CLOSE:
            continue
        column.depth[v] = t
        car_pixel(column, v, paint, clamp(facing, 0.0, 1.0), gloss, haze)


@kernel
def car_pixel(column: Column, v: int, paint: Colour, sun: float, gloss: float, haze: float) -> None:
    """Write a pixel of a vehicle, which mirrors the sky with this share of its colour."""
    look = column.look
    skylight, sunlight = triple(look, SKYLIGHT), triple(look, SUNLIGHT)
    horizon, zenith = triple(look, HORIZON), triple(look, ZENITH)
    red = paint[0] * (0.9 * skylight[0] + sun * sunlight[0])
    green = paint[1] * (0.9 * skylight[1] + sun * sunlight[1])
    blue = paint[2] * (0.9 * skylight[2] + sun * sunlight[2])
    sky = 0.5 * (horizon[0] + zenith[0]), 0.5 * (horizon[1] + zenith[1]), 0.5 * (horizon[2] + zenith[2])
    kernels.put_hazed(column, v, kernels.mix((red, green, blue), sky, gloss), haze, _VEHICLE)


@kernel
def walker(column: Column, row: Any) -> None:
    """Paint a pedestrian where they are the nearest: a figure that always faces the camera."""
    dx, dy, eye = column.dx, column.dy, column.eye
    ox, oy = row[X] - column.px, row[Y] - column.py
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
    a = first_row((height - eye) / t, column)
    b = first_row(-eye / t, column)
    haze = kernels.haze_at(t, column.look)
    # The stride follows the distance that the person has walked.
    phase = (row[X] * row[COS] + row[Y] * row[SIN]) * 1.3
    stride = 0.25 + 0.75 * abs(2.0 * (phase - kernels.floor(phase)) - 1.0)
    sun = 0.6 if aside > 0.0 else 0.35
    for v in range(a, b):
        if t >= column.depth[v]:
            continue
        y = (eye + column.slopes[v] * t) / height
        across = abs(aside) / width
        if y > 0.86:
            # The head is a disc.
            up = (y - 0.93) * height
            if up * up + aside * aside > 0.0145:
                continue
            colour = (70.0, 52.0, 40.0) if y > 0.945 else (206.0, 160.0, 132.0)
        elif y > 0.48:
            if across > (0.55 if y > 0.83 else 0.98):
                continue
            colour = toned(triple(row, R), 0.8 if across > 0.68 else 1.0)
            if across > 0.68 and y < 0.53:
                colour = 206.0, 160.0, 132.0
        else:
            spread = stride * (0.48 - y) * 1.1
            if across < spread - 0.06 or across > spread + 0.46:
                continue
            colour = triple(row, R2) if y >= 0.05 else (30.0, 30.0, 30.0)
        column.depth[v] = t
        kernels.put_lit(column, v, colour, sun, haze, _PEDESTRIAN)
