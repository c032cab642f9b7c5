"""Styles of scenery: what stands along a street, how densely, how high and how far back."""

import random
from dataclasses import dataclass
from typing import Final

from wrongturn_networks.scenery import SceneryKind

Range = tuple[float, float]
"""Least and greatest value."""
Barrier = tuple[SceneryKind, float, float, float]
"""Kind, thickness, least and greatest height, metres."""


@dataclass(frozen=True)
class Style:
    """What stands along one side of a street. Metres."""

    houses: float = 0.55
    """Share of places where a house is put, if there is room."""
    trees: float = 0.2
    """Share of places with a tree; the rest have walls, hedges and fences."""
    spacing: float = 1.0
    """By how much the gaps between things are longer than usual."""
    house_lengths: Range = (8.0, 17.0)
    house_depths: Range = (8.0, 12.0)
    house_heights: Range = (4.5, 16.0)
    gardens: tuple[float, ...] = (0.3, 1.5, 3.5)
    """How far houses stand back. Behind more than 3 m of garden, some have a fence, wall or hedge in front."""
    tree_heights: Range = (4.5, 8.5)
    crowns: Range = (1.4, 2.4)
    barriers: tuple[Barrier, ...] = (
        (SceneryKind.WALL, 0.4, 1.4, 2.4),
        (SceneryKind.HEDGE, 1.0, 0.9, 1.8),
        (SceneryKind.FENCE, 0.1, 0.9, 1.4),
    )


PLAIN: Final = Style()
"""The style of the shipped towns."""
OF_A_TOWN: Final = 3
"""Styles that a drawn scenery mixes, street by street."""


def drawn_style(draw: random.Random) -> Style:
    """Return a style that differs from others in all that a picture shows."""
    low = draw.uniform(3.5, 8.0)
    front = draw.uniform(0.2, 4.5)
    tree = draw.uniform(3.5, 8.0)
    crown = draw.uniform(1.0, 1.9)
    houses = draw.uniform(0.2, 0.75)
    length, depth = draw.uniform(6.0, 12.0), draw.uniform(7.0, 10.0)
    return Style(
        houses=houses,
        trees=draw.uniform(0.1, 0.9) * (1.0 - houses),
        spacing=draw.uniform(0.7, 1.6),
        house_lengths=(length, length + draw.uniform(3.0, 9.0)),
        house_depths=(depth, depth + draw.uniform(0.0, 4.0)),
        house_heights=(low, low + draw.uniform(2.0, 12.0)),
        gardens=tuple(front + draw.uniform(0.0, 4.0) for _ in range(3)),
        tree_heights=(tree, tree + draw.uniform(1.0, 4.0)),
        crowns=(crown, crown + draw.uniform(0.2, 1.0)),
        barriers=tuple(draw.sample(PLAIN.barriers, draw.randint(1, 3))),
    )
