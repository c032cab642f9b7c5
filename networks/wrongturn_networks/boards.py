"""Boards that close a street at its mouth: to see, to hit, and known to the traffic."""

import dataclasses
import functools
import hashlib
import math
from typing import Final

from wrongturn_networks.scenery import SceneryKind, SceneryObject, scenery_toml
from wrongturn_networks.town import Town, sha256_of_town
from wrongturn_protocol import Command

PAST: Final = 1.0
"""Boards stand this far past the exit line, metres."""
HEIGHT: Final = 1.1
_THICKNESS: Final = 0.1
_BOARD: Final = 1.0  # each is about so long, metres


@functools.lru_cache(maxsize=64)
def with_boards(town: Town, approach_id: str, direction: Command) -> Town:
    """Return the town with boards across the street of an exit, from kerb to kerb. Raises UnknownApproachError."""
    leaving = town.lanes[town.approach(approach_id).exits[direction].lane]
    coming = town.lanes.get(leaving.opposite or "")
    (x, y), (x2, y2) = leaving.centreline[:2].tolist()
    heading = math.atan2(y2 - y, x2 - x)
    cos, sin = math.cos(heading), math.sin(heading)
    across = abs(leaving.axis) + (coming.breadth if coming is not None else 0.0)
    right, left = (-leaving.kerb, across) if leaving.axis > 0.0 else (-across, leaving.kerb)
    count = max(round((left - right) / _BOARD), 1)
    length = (left - right) / count
    boards = tuple(
        SceneryObject(
            kind=SceneryKind.BOARD,
            x=round(x + PAST * cos - aside * sin, 3),
            y=round(y + PAST * sin + aside * cos, 3),
            yaw=round(math.remainder(heading + math.pi / 2, math.tau), 5),
            length=round(length, 3),
            width=_THICKNESS,
            height=HEIGHT,
            solid=True,
            seed=number,
        )
        for number in range(count)
        for aside in [right + (number + 0.5) * length]
    )
    scenery = (*town.scenery, *boards)
    found = hashlib.sha256(scenery_toml(scenery).encode()).hexdigest()
    return dataclasses.replace(
        town,
        scenery=scenery,
        sha256=sha256_of_town(town.net_sha256, found),
        closed=(leaving.id, *([coming.id] if coming is not None else [])),
        shipped=town.plain,
    )
