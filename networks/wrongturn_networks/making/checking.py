"""What a drawn town must offer: room for every type of trial, and no doubt about what a command means."""

import math
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from typing import Final

import networkx as nx
import numpy as np
from shapely import STRtree

from wrongturn_networks.junctions import Approach
from wrongturn_networks.lanes import Line, heading_of
from wrongturn_networks.town import Town
from wrongturn_protocol import PAPER_TYPES, Command

LEAST_LANE: Final = 48.0
"""Least length of a lane, metres: a start has room before the stop line, and a drive goes on after an exit."""
APPROACHES: Final = 3
"""Least number of approaches of each of the paper's types."""
TURNS: Final = {Command.STRAIGHT: (0.0, 30.0), Command.LEFT: (65.0, 115.0), Command.RIGHT: (-115.0, -65.0)}
"""Turns that a direction may mean, degrees; straight on, either way. 45° would already part them."""
LEAST_RADIUS: Final = 5.0
"""Least radius of a way through a junction, metres. The car's own is 4.14 m."""
LONGEST_WAY: Final = 36.0
"""Greatest length of a way through a junction, metres; Town01's longest is 31 m."""
_OVERLAP: Final = 1.0
_SEAM: Final = 5.0
"""Greatest area that two lanes or junctions share, and the two lanes of a bent street, square metres."""


def flaws(town: Town) -> Iterator[str]:
    """Yield what makes a town unfit for trials; nothing if it is fit."""
    yield from (f"{lane.id}: {lane.length:.1f} m" for lane in town.lanes.values() if lane.length < LEAST_LANE)
    counts = Counter(approach.type for approach in town.approaches.values())
    yield from (f"{counts[kind]} approaches of type {kind}" for kind in PAPER_TYPES if counts[kind] < APPROACHES)
    if len(town.approaches) != sum(lane.end_junction is not None for lane in town.lanes.values()):
        yield "two approaches of a junction have one name"
    for approach in town.approaches.values():
        yield from _flaws_at(town, approach)
    onward = [(a.lane, leaving.lane) for a in town.approaches.values() for leaving in a.exits.values()]
    if len(town.lanes) != max(map(len, nx.strongly_connected_components(nx.DiGraph(onward))), default=0):
        yield "some lane cannot be reached from another"
    yield from _overlaps(town)


def _flaws_at(town: Town, approach: Approach) -> Iterator[str]:
    if len(approach.exits) != len(town.junctions[approach.junction].approaches) - 1:
        yield f"{approach.id}: two exits have one direction, or an arm has none"
    for direction, leaving in approach.exits.items():
        turn = math.degrees(
            math.remainder(heading_of(town.lanes[leaving.lane].centreline[:2]) - approach.heading, math.tau)
        )
        low, high = TURNS[direction]
        if not low <= (abs(turn) if direction is Command.STRAIGHT else turn) <= high:
            yield f"{approach.id}: {direction.name} turns by {turn:.0f}°"
        if (length := float(np.hypot(*np.diff(leaving.path, axis=0).T).sum())) > LONGEST_WAY:
            yield f"{approach.id}: {direction.name} is {length:.1f} m long"
        if (radius := least_radius(leaving.path)) < LEAST_RADIUS:
            yield f"{approach.id}: {direction.name} bends by {radius:.1f} m"


def least_radius(path: Line) -> float:
    """Return the least radius of a path, metres, measured over about 4 m."""
    steps = np.hypot(*np.diff(path, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    places = np.arange(0.0, along[-1], 2.0)
    points = np.stack([np.interp(places, along, path[:, k]) for k in (0, 1)], axis=1)
    headings = [math.atan2(dy, dx) for dx, dy in np.diff(points, axis=0)]
    turns = [abs(math.remainder(b - a, math.tau)) for a, b in pairwise(headings)]
    return 2.0 / max(1e-6, *turns)


def _overlaps(town: Town) -> Iterator[str]:
    names = [*town.lanes, *town.junctions]
    grounds = [*(lane.polygon for lane in town.lanes.values()), *(one.area for one in town.junctions.values())]
    for a, b in STRtree(grounds).query(grounds, predicate="intersects").T.tolist():
        lane = town.lanes.get(names[a])
        most = _SEAM if lane is not None and lane.opposite == names[b] else _OVERLAP
        if a < b and (shared := grounds[a].intersection(grounds[b]).area) > most:
            yield f"{names[a]} and {names[b]} share {shared:.1f} m²"
