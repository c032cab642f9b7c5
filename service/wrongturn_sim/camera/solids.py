"""Scenery as rows of numbers. Each object's seed decides what it looks like."""

import math
import random
from collections.abc import Iterable
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_networks import SceneryKind, SceneryObject

HOUSE, WALL, HEDGE, TREE, FENCE, CAR, WALKER = range(7)
KINDS: Final = {
    **{SceneryKind(name): kind for kind, name in enumerate(("house", "wall", "hedge", "tree", "fence"))},
    SceneryKind.BOARD: WALL,
}

# Columns of a row. Every picture reads the first eight of every solid: they fill one line of the processor's cache.
X, Y, BOUND, KIND, COS, SIN, HALF_X, HALF_Y = range(8)
HEIGHT, RISE, R, G, B, R2, G2, B2, SEED, STOREY, BAY_X, BAY_Y, STYLE, RADIUS, MIDDLE, HALF_Z = range(8, 24)
WIDE, TALL, SHOP = range(24, 27)
COLUMNS: Final = 32

_FACADES: Final = (
    (158, 88, 70),
    (206, 184, 142),
    (224, 212, 186),
    (192, 122, 88),
    (156, 154, 150),
    (158, 176, 190),
    (206, 164, 92),
    (164, 174, 142),
    (228, 226, 220),
    (136, 106, 86),
    (208, 164, 152),
    (126, 66, 56),
    (188, 178, 164),
)
_ROOFS: Final = ((150, 78, 58), (86, 90, 98), (108, 84, 66), (122, 58, 48), (70, 72, 76))
_TRIMS: Final = ((236, 232, 222), (214, 206, 190), (92, 74, 60), (74, 84, 78))
_SHOPS: Final = ((150, 44, 42), (38, 78, 120), (40, 98, 72), (196, 150, 52), (70, 60, 88))
_OTHERS: Final = {
    SceneryKind.WALL: ((190, 168, 118), (168, 104, 82), (170, 166, 158), (204, 188, 150)),
    SceneryKind.HEDGE: ((54, 88, 40), (66, 98, 44), (48, 78, 46)),
    SceneryKind.FENCE: ((226, 222, 212), (126, 92, 62), (92, 84, 74)),
    SceneryKind.TREE: ((70, 106, 44), (88, 116, 46), (58, 92, 50), (104, 112, 44)),
}
_BOARDS: Final = ((196, 44, 36), (232, 230, 224))
"""Boards are red and white in turn."""
BRICK_STYLE: Final = 1.0


def crown_of(item: SceneryObject) -> tuple[float, float, float]:
    """Return the radius of a tree's crown, the height of its middle and half its height, metres."""
    half = max(min(item.height * 0.36, item.crown_radius * 1.35), item.crown_radius * 0.6)
    return item.crown_radius, item.height - half, half


def _row(item: SceneryObject) -> NDArray[np.float64]:
    row = np.zeros(COLUMNS)
    # Python's generator: in the time that numpy needs to make one of its own, this makes a thousand.
    draw = random.Random(item.seed)
    row[[X, Y, COS, SIN]] = item.x, item.y, math.cos(item.yaw), math.sin(item.yaw)
    row[[HALF_X, HALF_Y, HEIGHT, KIND]] = item.length / 2, item.width / 2, item.height, KINDS[item.kind]
    row[SEED] = item.seed & 0xFFFF
    row[BOUND] = math.hypot(item.length, item.width) / 2
    shade = draw.uniform(0.9, 1.06)
    if item.kind is SceneryKind.HOUSE:
        pitched = item.height < 12.0 and draw.random() < 0.75
        rise = min(item.width * draw.uniform(0.24, 0.4), item.height * 0.36) if pitched else 0.0
        eaves = item.height - rise
        storeys = max(1, round(eaves / draw.uniform(2.8, 3.3)))
        bay = draw.uniform(2.2, 3.4)
        row[HEIGHT], row[RISE], row[STOREY] = eaves, rise, eaves / storeys
        row[BAY_X] = item.length / max(1, round(item.length / bay))
        row[BAY_Y] = item.width / max(1, round(item.width / bay))
        row[[R, G, B]] = np.array(draw.choice(_FACADES)) * shade
        row[STYLE] = float(draw.randrange(3))
        if row[R] - row[G] > 40:
            row[STYLE] = BRICK_STYLE
        row[[R2, G2, B2]] = draw.choice(_ROOFS if pitched else _TRIMS[:2])
        row[WIDE], row[TALL] = draw.uniform(0.36, 0.56), draw.uniform(0.42, 0.56)
        row[SHOP] = float(draw.randrange(1, 1 + len(_SHOPS))) if storeys > 1 and draw.random() < 0.3 else 0.0
    else:
        if item.kind is SceneryKind.TREE:
            row[RADIUS], row[MIDDLE], row[HALF_Z] = crown_of(item)
            row[BOUND] = max(row[RADIUS], row[BOUND])
            row[[R2, G2, B2]] = np.array((98, 78, 58)) * shade
        board = item.kind is SceneryKind.BOARD
        row[[R, G, B]] = _BOARDS[item.seed % 2] if board else np.array(draw.choice(_OTHERS[item.kind])) * shade
    return row


def rows_of(scenery: Iterable[SceneryObject]) -> NDArray[np.float64]:
    """Return scenery as the renderer takes it, (N, COLUMNS)."""
    rows = [_row(item) for item in scenery]
    return np.array(rows) if rows else np.zeros((0, COLUMNS))


@cache
def shop_colours() -> NDArray[np.float64]:
    """Return the colours of shop signs, (N, 3), 0 to 255."""
    return np.array(_SHOPS, np.float64)
