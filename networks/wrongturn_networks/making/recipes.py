"""Recipes of towns: the numbers that each network is built from. ``recipes.toml`` has those of the shipped towns."""

import random
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from wrongturn_networks.making.styles import PLAIN, Style

Point = tuple[float, float]


@dataclass(frozen=True)
class Street:
    """A two-way street between two nodes."""

    start: str
    end: str
    corners: tuple[Point, ...] = ()
    """Corners between its ends, metres; each becomes an arc."""
    bends: tuple[float, ...] = ()
    """Radius of the centre line at each corner, metres; the recipe's ``bend_radius`` where it is left out."""
    lane_width: float = 4.0
    """Width of each of its two lanes, metres."""


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
    corner_radii: tuple[float, float] = (5.0, 9.0)
    """Least and greatest radius of a junction's corners, metres."""
    styles: tuple[Style, ...] | None = (PLAIN,)
    """Styles of the scenery; None lets the seed draw some."""

    def radii(self) -> dict[str, float]:
        """Return the corner radius of each junction; no two junctions of a town have the same."""
        draw = random.Random(self.seed)
        junctions = [node for node in self.nodes if node not in self.dead_ends]
        low, high = self.corner_radii
        steps = [low + (high - low) * step / max(1, len(junctions) - 1) for step in range(len(junctions))]
        draw.shuffle(steps)
        return {junction: round(radius, 2) for junction, radius in zip(junctions, steps, strict=True)}


def _recipe(name: str, told: dict[str, Any]) -> Recipe:
    streets = tuple(Street(start, end, _points(*corners)) for start, end, *corners in told["streets"])
    nodes = dict(zip(told["nodes"], _points(told["nodes"].values()), strict=True))
    return Recipe(name, nodes, streets, told["seed"], tuple(told.get("dead_ends", ())))


def _points(points: Iterable[list[float]] = ()) -> tuple[Point, ...]:
    return tuple((x, y) for x, y in points)


RECIPES: Final = {
    name: _recipe(name, told) for name, told in tomllib.loads(Path(__file__).with_suffix(".toml").read_text()).items()
}
