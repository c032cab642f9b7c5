"""Recipes of drawn towns: a grid of streets, some of them missing, bent and turned out of shape.

Streets curve between their ends. They meet at 75° to 105°, and near a junction each is straight, so that stop lines lie
square to them. Lanes, corners, blocks and scenery differ.
"""

import math
import random
from collections.abc import Iterator
from typing import Final

from shapely import LineString, STRtree
from shapely import Point as Place
from shapely.ops import substring

from wrongturn_networks.making.layouts import Layout, Node, drawn_layout, lines
from wrongturn_networks.making.plain_xml import SIDEWALK_WIDTH, centreline_of
from wrongturn_networks.making.recipes import Point, Recipe, Street

SIZES: Final = ((3, 3), (3, 4), (4, 3), (4, 4), (5, 3))
"""Streets from south to north, and from west to east."""
SPACING: Final = (84.0, 132.0)
"""Least and greatest distance between neighbouring streets before they are bent, metres."""
SHIFT: Final = 9.0
"""By how much places are moved at most, metres east and north."""
TOWN_TURN: Final = math.radians(10)
JUNCTION_TURN: Final = math.radians(8)
ARM_TURN: Final = math.radians(7.5)
"""Greatest turns out of the compass of a town, a junction and an arm: neighbouring arms are 75° to 105° apart."""
STRAIGHT: Final = 23.0
"""Every street is straight for this long from a junction's middle, metres: stop lines are nearer."""
KNEE: Final = (27.0, 38.0)
"""Distance of a street's first corner from the junction's middle, metres."""
SWAY: Final = 0.1
"""A street between neighbours leaves the line by up to this share of its length."""
LEAST_BEND: Final = 9.0
"""Least radius of a centre line, metres."""
LANE_WIDTHS: Final = (3.5, 4.25)
_CORNERS: Final = ((5.0, 6.5), (7.0, 9.0))
"""Ranges of a town's least and greatest corner radius, metres."""
_SEED_BITS: Final = 53
_HALF: Final = LANE_WIDTHS[1] + SIDEWALK_WIDTH
_APART: Final = 3.0
"""Least distance between the sidewalks of two streets, and between one and a junction that is not its own, metres."""
_TRIES: Final = 2000


def drawn_recipes(name: str) -> Iterator[Recipe]:
    """Yield recipes for the drawn town of a name, always the same ones. The first that stands the checks is the town.

    Raises RuntimeError if there are none left, which no seed is known to bring about.
    """
    draw = random.Random(name)
    for _ in range(_TRIES):
        recipe = _drawn(draw, name)
        if recipe is not None:
            yield recipe
    raise RuntimeError(f"none of {_TRIES} layouts makes a town")


def _drawn(draw: random.Random, name: str) -> Recipe | None:
    columns, rows = draw.choice(SIZES)
    layout = drawn_layout(draw, columns, rows)
    if layout is None:
        return None
    town_turn = draw.uniform(-TOWN_TURN, TOWN_TURN)
    places = _places(draw, columns, rows, town_turn)
    arms = _arms(draw, layout, town_turn)
    streets = []
    for chain in layout.chains:
        street = _street(draw, layout, chain, places, arms)
        if street is None:
            return None
        streets.append(street)
    nodes = {label: places[node] for node, label in layout.names.items()}
    corners = draw.uniform(*_CORNERS[0]), draw.uniform(*_CORNERS[1])
    seed = draw.getrandbits(_SEED_BITS)
    recipe = Recipe(name, nodes, tuple(streets), seed, corner_radii=corners, styles=None)
    return recipe if _is_free(recipe) else None


def _places(draw: random.Random, columns: int, rows: int, turn: float) -> dict[Node, Point]:
    """Return where the grid's places lie, metres."""
    xs, ys = lines(draw, columns, SPACING), lines(draw, rows, SPACING)
    places = {}
    for i in range(columns):
        for j in range(rows):
            x, y = xs[i] + draw.uniform(-SHIFT, SHIFT), ys[j] + draw.uniform(-SHIFT, SHIFT)
            places[i, j] = _moved((0.0, 0.0), x * math.cos(turn) - y * math.sin(turn),
                                  x * math.sin(turn) + y * math.cos(turn))  # fmt: skip
    return places


def _moved(point: Point, dx: float, dy: float) -> Point:
    return round(point[0] + dx, 2), round(point[1] + dy, 2)


def _arms(draw: random.Random, layout: Layout, town_turn: float) -> dict[tuple[Node, Node], float]:
    """Return the headings in which streets leave their junctions, by junction and next place, radians."""
    ways = sorted({way for chain in layout.chains for way in ((chain[0], chain[1]), (chain[-1], chain[-2]))})
    turns = {node: town_turn + draw.uniform(-JUNCTION_TURN, JUNCTION_TURN) for node in layout.names}
    return {
        (node, step): math.atan2(step[1] - node[1], step[0] - node[0]) + turns[node] + draw.uniform(-ARM_TURN, ARM_TURN)
        for node, step in ways
    }


def _street(
    draw: random.Random,
    layout: Layout,
    chain: list[Node],
    places: dict[Node, Point],
    arms: dict[tuple[Node, Node], float],
) -> Street | None:
    """Return a street along some places; None if it would have to bend too sharply."""
    points = [places[node] for node in chain]
    first, last = (
        _moved(at, knee * math.cos(arm), knee * math.sin(arm))
        for at, arm, knee in (
            (points[0], arms[chain[0], chain[1]], draw.uniform(*KNEE)),
            (points[-1], arms[chain[-1], chain[-2]], draw.uniform(*KNEE)),
        )
    )
    between = points[1:-1]
    if not between:
        sway = draw.uniform(-SWAY, SWAY)
        (x0, y0), (x1, y1) = first, last
        between = [_moved(((x0 + x1) / 2, (y0 + y1) / 2), sway * (y0 - y1), sway * (x1 - x0))]
    line = [points[0], first, *between, last, points[-1]]
    bends = []
    for k in range(1, len(line) - 1):
        into, out = math.dist(line[k - 1], line[k]), math.dist(line[k], line[k + 1])
        # What a bend may take of the pieces beside it. The ends stay straight; a piece between two bends is shared.
        room = min(into - STRAIGHT if k == 1 else into / 2, out - STRAIGHT if k == len(line) - 2 else out / 2)
        turn = abs(_turn(line[k - 1], line[k], line[k + 1]))
        bends.append(round(draw.uniform(0.6, 1.0) * room / math.tan(max(turn, 1e-3) / 2), 2))
    if min(bends) < LEAST_BEND:
        return None
    width = round(draw.uniform(*LANE_WIDTHS), 2)
    return Street(layout.names[chain[0]], layout.names[chain[-1]], tuple(line[1:-1]), tuple(bends), width)


def _turn(before: Point, at: Point, after: Point) -> float:
    return math.remainder(
        math.atan2(after[1] - at[1], after[0] - at[0]) - math.atan2(at[1] - before[1], at[0] - before[0]), math.tau
    )


def _is_free(recipe: Recipe) -> bool:
    """Return whether streets keep off each other, off themselves, and off the junctions of others."""
    near = STRAIGHT + 2.0
    centres = [LineString(centreline_of(recipe, street)) for street in recipe.streets]
    middles = [substring(line, near, line.length - near) for line in centres]
    strips = [line.buffer(_HALF + _APART / 2, cap_style="flat") for line in middles]
    if not all(line.is_simple for line in centres):
        return False
    # A strip that covers itself is smaller than its length says.
    if any(strip.area < 0.97 * line.length * (2 * _HALF + _APART) for strip, line in zip(strips, middles, strict=True)):
        return False
    pairs = STRtree(strips).query(strips, predicate="intersects").T
    if any(a != b for a, b in pairs):
        return False
    squares = [Place(at).buffer(STRAIGHT - 4.0) for at in recipe.nodes.values()]
    if len(STRtree(squares).query(strips, predicate="intersects").T):
        return False
    ends = [{street.start, street.end} for street in recipe.streets]
    names = list(recipe.nodes)
    # The straight ends, where they pass junctions that are not theirs.
    whole = [line.buffer(_HALF + _APART) for line in centres]
    met = STRtree(squares).query(whole, predicate="intersects").T
    return all(names[square] in ends[street] for street, square in met)
