"""Recipes of the towns: the numbers that each network is built from.

Town01 and Town02 follow the centre lines of CARLA's towns with these names. ``junctions`` is a small town for first
steps and tests, with an approach of each type.
"""

import random
from dataclasses import dataclass
from typing import Final

Point = tuple[float, float]


@dataclass(frozen=True)
class Street:
    """A two-way street between two nodes."""

    start: str
    end: str
    corners: tuple[Point, ...] = ()
    """Corners between its ends, metres; each becomes an arc."""


@dataclass(frozen=True)
class Recipe:
    """The recipe of a town."""

    name: str
    nodes: dict[str, Point]
    """Junctions and dead ends, metres."""
    streets: tuple[Street, ...]
    seed: int
    """Seed of the junctions' radii and of the scenery."""
    dead_ends: tuple[str, ...] = ()
    bend_radius: float = 10.0
    """Radius of the centre line at corners, metres."""

    def radii(self) -> dict[str, float]:
        """Return the corner radius of each junction, 5 to 9 m; no two junctions of a town have the same."""
        draw = random.Random(self.seed)
        junctions = [node for node in self.nodes if node not in self.dead_ends]
        steps = [5.0 + 4.0 * step / max(1, len(junctions) - 1) for step in range(len(junctions))]
        draw.shuffle(steps)
        return {junction: round(radius, 2) for junction, radius in zip(junctions, steps, strict=True)}


TOWN01: Final = Recipe(
    name="Town01",
    nodes={
        "J1": (90.5, 0.0),
        "J2": (336.8, 0.0),
        "J3": (90.5, 131.4),
        "J4": (336.8, 131.4),
        "J5": (90.5, 197.2),
        "J6": (336.8, 197.2),
        "J7": (90.5, 271.1),
        "J8": (156.1, 271.1),
        "J9": (336.8, 271.1),
        "J10": (90.5, 328.6),
        "J11": (156.1, 328.6),
        "J12": (336.8, 328.6),
    },
    streets=(
        Street("J1", "J2"),
        Street("J2", "J12", ((394.4, 0.0), (394.4, 328.6))),
        Street("J12", "J11"),
        Street("J11", "J10"),
        Street("J10", "J1", ((0.0, 328.6), (0.0, 0.0))),
        Street("J1", "J3"),
        Street("J3", "J5"),
        Street("J5", "J7"),
        Street("J7", "J10"),
        Street("J2", "J4"),
        Street("J4", "J6"),
        Street("J6", "J9"),
        Street("J9", "J12"),
        Street("J3", "J4"),
        Street("J5", "J6"),
        Street("J7", "J8"),
        Street("J8", "J9"),
        Street("J8", "J11"),
    ),
    seed=1,
)

TOWN02: Final = Recipe(
    name="Town02",
    nodes={
        "J1": (49.3, 0.0),
        "J2": (49.3, 65.7),
        "J3": (49.3, 115.0),
        "J4": (139.6, 65.7),
        "J5": (139.6, 115.0),
        "J6": (197.2, 65.7),
        "J7": (197.2, 115.0),
        "J8": (0.0, 115.0),
    },
    streets=(
        Street("J8", "J1", ((0.0, 0.0),)),
        Street("J1", "J6", ((197.2, 0.0),)),
        Street("J6", "J7"),
        Street("J7", "J8", ((197.2, 197.2), (0.0, 197.2))),
        Street("J8", "J3"),
        Street("J3", "J5"),
        Street("J5", "J7"),
        Street("J2", "J4"),
        Street("J4", "J6"),
        Street("J1", "J2"),
        Street("J2", "J3"),
        Street("J4", "J5"),
    ),
    seed=9,  # leaves every approach long enough to start on
)

JUNCTIONS: Final = Recipe(
    name="junctions",
    nodes={
        "J1": (0.0, 0.0),
        "J2": (110.0, 0.0),
        "W": (-80.0, 0.0),
        "S": (0.0, -80.0),
        "E": (190.0, 0.0),
        "N": (110.0, 80.0),
        "SE": (110.0, -80.0),
    },
    streets=(
        Street("J1", "J2"),
        Street("J1", "W"),
        Street("J1", "S"),
        Street("J2", "E"),
        Street("J2", "N"),
        Street("J2", "SE"),
    ),
    seed=3,
    dead_ends=("W", "S", "E", "N", "SE"),
)

RECIPES: Final = {recipe.name: recipe for recipe in (TOWN01, TOWN02, JUNCTIONS)}
