"""Places where a car can be, and what its picture should tell: how far the junction is, and which exits it has."""

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wrongturn_agents.models.doubt import FARTHEST
from wrongturn_networks import Town
from wrongturn_protocol import DIRECTIONS
from wrongturn_sim.roads import roads_of

Numbers = NDArray[np.float64]

STEP: Final = 0.25
"""Distance between the points of lanes and paths from which places are drawn, metres."""
NEAR: Final = 30.0
"""A place this far from the stop line or nearer is near, metres."""
SHARES: Final = {"near": 0.55, "inside": 0.2, "after": 0.1, "elsewhere": 0.15}
"""Shares of the places that are drawn: near a stop line; between stop line and exit line; in the first 12 m of a
lane; anywhere else, bends included."""
_AFTER: Final = 12.0
_LATERAL: Final = (0.35, 1.7)
"""Standard deviation of the distance from the lane's centre, and its greatest size for a car astray, metres."""
_YAW: Final = (0.06, 0.4)
"""The same for the angle to the lane, radians."""
_ASTRAY: Final = 0.25
"""Share of the places off the ideal line, where a car gets that was told wrong."""


class Places(NamedTuple):
    """Places of cars in one town, and the truth about each."""

    poses: Numbers
    """(n, 3): x, y, yaw of the body's centre; metres, metres, radians."""
    distance: Numbers
    """(n,): metres to the stop line along the lane; 0 inside a junction, FARTHEST where there is none nearer."""
    exits: NDArray[np.float32]
    """(n, 3): 1 for each exit that the junction ahead has: left, right, straight."""
    shown: NDArray[np.float32]
    """(n,): 1 where the exits ahead are to be told: before the stop line, and not too far from it."""


class Points(NamedTuple):
    """Points along a town's lanes and paths."""

    poses: Numbers
    distance: Numbers
    exits: NDArray[np.float32]
    groups: dict[str, NDArray[np.int64]]
    """Rows of each group of :data:`SHARES`."""


def draw_places(town: Town, random: np.random.Generator, count: int) -> Places:
    """Draw places in a town with their truth, most of them near junctions and a quarter of them off the ideal line."""
    points = points_of(town)
    names = [name for name, rows in points.groups.items() if len(rows)]
    shares = np.array([SHARES[name] for name in names])
    kinds = random.choice(len(names), count, p=shares / shares.sum())
    rows = np.empty(count, np.int64)
    for kind, name in enumerate(names):
        of_kind = np.flatnonzero(kinds == kind)
        rows[of_kind] = random.choice(points.groups[name], len(of_kind))
    astray = random.random(count) < _ASTRAY
    lateral, yaw = (
        np.where(astray, random.uniform(-most, most, count), np.clip(random.normal(0.0, usual, count), -most, most))
        for usual, most in (_LATERAL, _YAW)
    )
    poses = points.poses[rows].copy()
    poses[:, 0] -= lateral * np.sin(poses[:, 2])
    poses[:, 1] += lateral * np.cos(poses[:, 2])
    poses[:, 2] += yaw
    distance = points.distance[rows]
    shown = (distance > 0.0) & (distance <= NEAR)
    return Places(poses, np.minimum(distance, FARTHEST), points.exits[rows], shown.astype(np.float32))


@lru_cache(maxsize=128)
def points_of(town: Town) -> Points:
    """Return points along all lanes of a town, and along the paths through its junctions."""
    roads = roads_of(town)
    poses: list[Numbers] = []
    distances: list[Numbers] = []
    exits: list[NDArray[np.float32]] = []
    groups: dict[str, list[NDArray[np.int64]]] = {name: [] for name in SHARES}
    total = 0

    def put(line: Numbers, along: Numbers, places: Numbers) -> NDArray[np.int64]:
        nonlocal total
        at = np.clip(np.searchsorted(along, places, side="right") - 1, 0, len(along) - 2)
        steps = line[at + 1] - line[at]
        share = (places - along[at]) / np.maximum(along[at + 1] - along[at], 1e-9)
        headings = np.arctan2(steps[:, 1], steps[:, 0])
        poses.append(np.column_stack([line[at] + share[:, None] * steps, headings]))
        total += len(places)
        return np.arange(total - len(places), total)

    for leg, lane in enumerate(roads.lanes):
        approach = roads.approaches[leg]
        s = np.arange(0.0, lane.length, STEP)
        rows = put(lane.points, lane.along, s)
        left = np.full(len(s), math.inf) if approach is None else lane.length - s
        distances.append(left)
        mask = np.array([approach is not None and way in approach.exits for way in DIRECTIONS], np.float32)
        exits.append(np.tile(mask, (len(s), 1)))
        groups["near"].append(rows[left <= NEAR])
        groups["after"].append(rows[s <= _AFTER])
        groups["elsewhere"].append(rows[left > NEAR])
        for gate in range(0 if approach is None else len(approach.exits)):
            line, along = roads.path_of(leg, gate)
            s = np.arange(0.0, float(roads.gates[leg, gate].inner), STEP)
            groups["inside"].append(put(line, along, s))
            distances.append(np.zeros(len(s)))
            exits.append(np.tile(mask, (len(s), 1)))
    return Points(
        np.concatenate(poses),
        np.concatenate(distances),
        np.concatenate(exits),
        {name: np.concatenate([np.empty(0, np.int64), *rows]) for name, rows in groups.items()},
    )
