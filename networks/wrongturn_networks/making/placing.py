"""Placing of scenery, by a seed: along the streets, and a backdrop behind each T-junction."""

import functools
import itertools
import math
import random
from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

from shapely import Point, union_all
from shapely.geometry.base import BaseGeometry
from shapely.prepared import prep

from wrongturn_networks.junctions import Approach
from wrongturn_networks.lanes import Line
from wrongturn_networks.making.styles import OF_A_TOWN, PLAIN, Style, drawn_style
from wrongturn_networks.scenery import SceneryKind, SceneryObject
from wrongturn_networks.town import Town
from wrongturn_protocol import Command

MARGIN: Final = 0.5
"""Least distance of an object from road or sidewalk, metres."""
GAP: Final = 0.4
"""Least distance between objects, metres."""
TURN: Final = {Command.LEFT: math.pi / 2, Command.RIGHT: -math.pi / 2, Command.STRAIGHT: 0.0}
BACKDROPS: Final = ("wall", "hedge", "house", "open", "trees", "fence")


Built = tuple[SceneryKind, float, float, float, tuple[float, float, float]]
"""Kind, x, y, yaw and length, width, height of an object; metres, radians."""


def place_scenery(
    town: Town, seed: int, styles: Sequence[Style] | None = None, built: Sequence[Built] = ()
) -> tuple[SceneryObject, ...]:
    """Return scenery for a town, off the road, sidewalks and other objects; the same seed gives the same scenery.

    Each side of each street has one of the styles. Without styles, the seed draws some. What is ``built`` has its place
    before all others.
    """
    draw = random.Random(seed if styles else f"scenery {seed}")
    chosen = styles or [drawn_style(draw) for _ in range(OF_A_TOWN)]
    placer = _Placer(town, draw)
    for one in built:
        placer.put(*one)
    # The three approaches of a T-junction lack the same arm, so each junction gets one backdrop.
    lacking = {a.junction: a for a in town.approaches.values() if a.type.missing is not None}
    for number, approach in enumerate(lacking.values()):
        placer.behind(approach, number)
    for lane in {lane.edge: lane for lane in town.lanes.values()}.values():
        # Each lane has its own side of the street; the only lane of a one-way street has both.
        for side in (lane.axis,) if lane.opposite is not None else (lane.axis, -lane.axis):
            style = chosen[0] if len(chosen) == 1 else draw.choice(chosen)
            placer.along(lane.centreline, lane.kerb if side == lane.axis else abs(side), side > 0.0, style)
    return tuple(placer.placed)


class _Placer:
    """Places objects where there is room."""

    def __init__(self, town: Town, draw: random.Random) -> None:
        self.draw = draw
        self.free_of = prep(_kept_free(town))
        self.placed: list[SceneryObject] = []
        self.near = _Near()
        # Each town uses the backdrops in an order of its own.
        self.order = list(BACKDROPS)
        self.draw.shuffle(self.order)
        self.town = town

    def put(self, kind: SceneryKind, x: float, y: float, yaw: float, size: tuple[float, float, float],
            crown_radius: float = 0.0) -> bool:  # fmt: skip
        """Place an object if there is room, and return whether there was; size is length, width, height in metres."""
        item = SceneryObject(
            kind=kind,
            x=round(x, 2),
            y=round(y, 2),
            yaw=round(math.remainder(yaw, math.tau), 4),
            length=round(size[0], 2),
            width=round(size[1], 2),
            height=round(size[2], 2),
            solid=kind is not SceneryKind.FENCE,
            seed=self.draw.randrange(2**31),
            crown_radius=round(crown_radius, 2),
        )
        footprint = item.footprint()
        if self.free_of.intersects(footprint) or not self.near.take(item, footprint):
            return False
        self.placed.append(item)
        return True

    def behind(self, approach: Approach, number: int) -> None:
        """Place what a car sees, and may hit, where the arm that the approach lacks would be."""
        assert approach.type.missing is not None
        junction = self.town.junctions[approach.junction]
        backdrop = self.order[number % len(self.order)]
        heading = approach.heading + TURN[approach.type.missing]
        across = heading + math.pi / 2
        start = self._beyond(junction.position, heading)
        if backdrop == "open":
            return
        for offset in (0.0, -12.0, 12.0, -24.0, 24.0):
            depth = start + {"wall": 1.5, "hedge": 1.2, "house": 6.5, "trees": 2.0, "fence": 1.0}[backdrop]
            depth += self.draw.uniform(0.0, 1.5)
            x = junction.position[0] + depth * math.cos(heading) + offset * math.cos(across)
            y = junction.position[1] + depth * math.sin(heading) + offset * math.sin(across)
            self._backdrop(backdrop, x, y, across)

    def _backdrop(self, backdrop: str, x: float, y: float, yaw: float) -> None:
        draw = self.draw
        if backdrop == "wall":
            self.put(SceneryKind.WALL, x, y, yaw, (11.4, 0.4, draw.uniform(1.6, 2.6)))
        elif backdrop == "hedge":
            self.put(SceneryKind.HEDGE, x, y, yaw, (11.4, 1.0, draw.uniform(1.0, 1.8)))
        elif backdrop == "fence":
            self.put(SceneryKind.FENCE, x, y, yaw, (11.4, 0.1, draw.uniform(0.9, 1.3)))
        elif backdrop == "house":
            self.put(SceneryKind.HOUSE, x, y, yaw, (draw.uniform(9.5, 11.4), 10.0, draw.uniform(5.5, 14.0)))
        else:
            for shift in (-4.0, 0.0, 4.0):
                self._tree(x + shift * math.cos(yaw), y + shift * math.sin(yaw), PLAIN)

    def _tree(self, x: float, y: float, style: Style) -> None:
        trunk = self.draw.uniform(0.3, 0.5)
        yaw, height = self.draw.uniform(0, math.pi), self.draw.uniform(*style.tree_heights)
        self.put(SceneryKind.TREE, x, y, yaw, (trunk, trunk, height), self.draw.uniform(*style.crowns))

    def _beyond(self, position: tuple[float, float], heading: float) -> float:
        """Return how far from a junction's middle road and sidewalk end in a direction, metres."""
        reach = 1.0
        while reach < 40 and self.free_of.intersects(
            Point(position[0] + reach * math.cos(heading), position[1] + reach * math.sin(heading))
        ):
            reach += 0.25
        return reach

    def along(self, centreline: Line, kerb: float, right: bool, style: Style) -> None:
        """Place houses, walls, hedges and trees on a side of a lane, whose kerb is so far from its middle, metres."""
        draw = self.draw
        position, travelled = 0, draw.uniform(2.0, 6.0)
        steps = [math.dist(a, b) for a, b in pairwise(centreline)]
        total = sum(steps)
        while travelled < total - 2.0:
            walked = 0.0
            for position, step in enumerate(steps):  # noqa: B007 - the index is what is wanted
                if walked + step >= travelled:
                    break
                walked += step
            (x0, y0), (x1, y1) = centreline[position], centreline[position + 1]
            yaw = math.atan2(y1 - y0, x1 - x0)
            share = (travelled - walked) / steps[position]
            x, y = x0 + share * (x1 - x0), y0 + share * (y1 - y0)
            travelled += self._beside(x, y, yaw, math.copysign(kerb + 2.5 + MARGIN, 1 if right else -1), style)

    def _beside(self, x: float, y: float, yaw: float, kerb: float, style: Style) -> float:
        """Place something beside a point of a lane, and return the metres to the next point.

        ``kerb`` is positive on the right and negative on the left.
        """
        draw = self.draw
        side, kerb = math.copysign(1.0, kerb), abs(kerb)

        def right(distance: float) -> tuple[float, float]:
            return x + side * distance * math.sin(yaw), y - side * distance * math.cos(yaw)

        what = draw.random()
        if what < style.houses:
            length, depth = draw.uniform(*style.house_lengths), draw.uniform(*style.house_depths)
            garden = draw.choice(style.gardens)
            height = draw.uniform(*style.house_heights)
            if self.put(SceneryKind.HOUSE, *right(kerb + garden + depth / 2), yaw, (length, depth, height)):
                if garden > 3 and draw.random() < 0.6:
                    kind, thick = draw.choice(
                        ((SceneryKind.HEDGE, 0.8), (SceneryKind.FENCE, 0.1), (SceneryKind.WALL, 0.3))
                    )
                    self.put(kind, *right(kerb + 0.2 + thick / 2), yaw, (length, thick, draw.uniform(0.8, 1.5)))
                return length / 2 + draw.uniform(5.0, 9.5) * style.spacing
            return 3.0
        if what < style.houses + style.trees:
            self._tree(*right(kerb + draw.uniform(0.6, 2.5)), style)
            return draw.uniform(4.0, 8.0) * style.spacing
        kind, thick, low, high = draw.choice(style.barriers)
        length = draw.uniform(5.0, 12.0)
        self.put(kind, *right(kerb + 0.2 + thick / 2), yaw, (length, thick, draw.uniform(low, high)))
        return length / 2 + draw.uniform(4.0, 8.0) * style.spacing


@functools.lru_cache(maxsize=64)
def _kept_free(town: Town) -> BaseGeometry:
    """Return where nothing may stand: road, sidewalks and a margin."""
    return union_all([town.road, town.sidewalks]).buffer(MARGIN)


class _Near:
    """The ground that objects cover, by the cells of a grid in which their middles lie."""

    CELL: Final = 28.0
    """Metres; no two objects meet whose middles are farther apart."""

    def __init__(self) -> None:
        self._cells: defaultdict[tuple[int, int], list[tuple[SceneryObject, BaseGeometry]]] = defaultdict(list)

    def take(self, item: SceneryObject, footprint: BaseGeometry) -> bool:
        """Return whether there is room for an object, and take its ground then."""
        column, row = int(item.x // self.CELL), int(item.y // self.CELL)
        reach, roomy = _reach(item) + GAP, None
        for cell in itertools.product(range(column - 1, column + 2), range(row - 1, row + 2)):
            for other, ground in self._cells.get(cell, ()):
                if math.dist((item.x, item.y), (other.x, other.y)) < reach + _reach(other):
                    roomy = footprint.buffer(GAP) if roomy is None else roomy
                    if roomy.intersects(ground):
                        return False
        self._cells[column, row].append((item, footprint))
        return True


def _reach(item: SceneryObject) -> float:
    return math.hypot(item.length, item.width) / 2
