"""Scenery: objects beside the road, to see and to hit."""

import hashlib
import math
import tomllib
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from shapely import Polygon

from wrongturn_networks.errors import CorruptFileError


class SceneryKind(StrEnum):
    """Kinds of objects."""

    HOUSE = "house"
    WALL = "wall"
    HEDGE = "hedge"
    TREE = "tree"
    FENCE = "fence"
    BOARD = "board"  # only where a trial's fault closes a street


@dataclass(frozen=True)
class SceneryObject:
    """An oriented box beside the road; a tree's box is its trunk. Metres, radians, town frame."""

    kind: SceneryKind
    x: float
    """Position of its middle."""
    y: float
    yaw: float
    """Heading of its long axis."""
    length: float
    width: float
    height: float
    solid: bool
    """Whether hitting it is a collision."""
    seed: int
    """Seed of its appearance."""
    crown_radius: float = 0.0
    """Radius of a tree's crown; a car may pass below it."""

    def footprint(self) -> Polygon:
        """Return the ground that it covers."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        # In the order in which shapely's box has them.
        corners = ((0.5, -0.5), (0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5))
        points = [(along * self.length, across * self.width) for along, across in corners]
        return Polygon([(self.x + cos * u - sin * v, self.y + sin * u + cos * v) for u, v in points])


def read_scenery(path: Path) -> tuple[SceneryObject, ...]:
    """Read a town's ``scenery.toml``; a town without the file has no scenery. Raises CorruptFileError."""
    if not path.exists():
        return ()
    try:
        rows = tomllib.loads(path.read_text("utf-8")).get("object", [])
        return tuple(SceneryObject(**{**row, "kind": SceneryKind(row["kind"])}) for row in rows)
    except (OSError, AttributeError, TypeError, ValueError, KeyError) as error:
        raise CorruptFileError(f"{path.name}: {error}; build the town again") from error


def sha256_of_scenery(path: Path) -> str:
    """Return the SHA-256 of a ``scenery.toml``; a missing one counts as empty."""
    return hashlib.sha256(path.read_bytes() if path.exists() else b"").hexdigest()


def scenery_toml(objects: tuple[SceneryObject, ...]) -> str:
    """Return scenery as the text of a ``scenery.toml``."""
    lines = ["# Made by python -m wrongturn_networks.making; a change belongs in its recipe."]
    for item in objects:
        lines += ["", "[[object]]", f'kind = "{item.kind}"']
        lines += [f"{name} = {getattr(item, name)}" for name in ("x", "y", "yaw", "length", "width", "height")]
        lines += [f"solid = {str(item.solid).lower()}", f"seed = {item.seed}"]
        if item.crown_radius:
            lines.append(f"crown_radius = {item.crown_radius}")
    return "\n".join(lines) + "\n"
