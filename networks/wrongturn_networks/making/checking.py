"""What a drawn town must offer: room for every type of trial, and no doubt about what a command means.

And which junctions of an imported net leave no such doubt.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Final

import networkx as nx
import numpy as np
from shapely import STRtree

from wrongturn_networks.junctions import Approach
from wrongturn_networks.lanes import Line, heading_of
from wrongturn_networks.loading import town_of_net
from wrongturn_networks.netfile import Net
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


SURE: Final = {Command.STRAIGHT: (0.0, 35.0), Command.LEFT: (50.0, 130.0), Command.RIGHT: (-130.0, -50.0)}
"""Turns that a direction may mean in an imported town, degrees."""
TIGHTEST: Final = 4.2
"""Least radius of a way through a junction of an imported town, metres."""
LEAST_EXIT: Final = 12.0
"""Least length of a lane behind a junction of an imported town, metres: a drive goes on after an exit."""


def unfit(net: Net, name: str) -> tuple[list[str], dict[str, str]]:
    """Return the nodes of a net that work as junctions, and what does not work with its reason.

    The reasons are by node, and by lane for single approaches of junctions that work. Bends and dead ends are neither.
    """
    arms = _arms(net)
    reasons = {node: reason for node, count in arms.items() if (reason := _unfit_node(net, node, count))}
    nodes = {node: node for node, count in arms.items() if count > 2 and node not in reasons}
    nowhere = Path()
    town = town_of_net(
        net, nodes, net.crossed, name=name, directory=nowhere, net_file=nowhere, net_sha256="", sha256="", scenery=()
    )
    covered: dict[str, str] = {}
    for (a, b), shared in _shared(town):
        reason = f"levels: {a} and {b} cover {shared:.0f} m² of the same ground, as at a bridge"
        covered |= {one: reason for one in (a, b) if one not in covered}
    works = dict.fromkeys(nodes, 0)
    chosen = [*net.car_lanes.values()]
    for lane in (town.lanes[one] for one in chosen):
        if lane.end_junction is None:
            continue
        approach = town.approach_of_lane(lane.id)
        reason = next(_unfit_approach(town, approach, arms[lane.end_junction], covered), None) if approach else (
            "exits: no junction type has just those of its lane; one-way streets or forbidden turns leave no choice"
        )  # fmt: skip
        if reason is None:
            works[lane.end_junction] += 1
        else:
            reasons[lane.id] = f"{lane.end_junction}: {reason}"
    for node in [node for node, count in works.items() if not count]:
        inner = [lane for lane in chosen if town.lanes[lane].end_junction == node and lane in reasons]
        found = {reasons.pop(lane).removeprefix(f"{node}: ") for lane in inner}
        reasons[node] = "; ".join(sorted(found)) or "exits: no car drives in"
    return [node for node, count in works.items() if count], reasons


def _arms(net: Net) -> Counter[str]:
    """Return the number of streets that meet at each node."""
    streets: dict[frozenset[str], Counter[tuple[str, str]]] = defaultdict(Counter)
    for edge in net.streets:
        streets[frozenset(net.edges[edge])][net.edges[edge]] += 1
    arms: Counter[str] = Counter()
    for ends, edges in streets.items():
        # Two one-way streets in one direction are two arms; one in each direction is a street both ways.
        arms.update(dict.fromkeys(ends, max(edges.values())))
    return arms


def _unfit_node(net: Net, node: str, arms: int) -> str | None:
    kind = net.junctions[node].type
    if arms < 3:
        return None
    if node in net.roundabouts:
        return "roundabout: no command names its exits"
    if kind.startswith("traffic_light"):
        return "signals: no trial has any; --option=--tls.discard-loaded takes them away"
    if kind.startswith("rail"):
        return f"railway: no trial has a {kind}"
    return f"{arms} arms: commands name three exits" if arms > 4 else None


def _unfit_approach(town: Town, approach: Approach, arms: int, covered: Mapping[str, str]) -> Iterator[str]:
    """Yield what makes an imported approach unfit."""
    if len(approach.exits) != arms - 1:
        names = ", ".join(direction.name for direction in approach.exits)
        yield (
            f"exits: the lane leads to {names} alone, and {arms - 1} other arms meet here (a one-way street, a "
            "forbidden turn, a turn from another lane, or two arms in one direction)"
        )
    yield from _turns(town, approach, SURE, TIGHTEST, "; --option=--default.junctions.radius=9 rounds corners")
    for direction, leaving in approach.exits.items():
        if (length := town.lanes[leaving.lane].length) < LEAST_EXIT:
            yield f"room: {direction.name} leads into {length:.1f} m of street; {LEAST_EXIT:g} are needed"
    for one in (approach.lane, *(leaving.lane for leaving in approach.exits.values())):
        if one in covered:
            yield covered[one]


def _flaws_at(town: Town, approach: Approach) -> Iterator[str]:
    if len(approach.exits) != len(town.junctions[approach.junction].approaches) - 1:
        yield f"{approach.id}: two exits have one direction, or an arm has none"
    yield from (f"{approach.id}: {flaw}" for flaw in _turns(town, approach, TURNS, LEAST_RADIUS))
    for direction, leaving in approach.exits.items():
        if (length := float(np.hypot(*np.diff(leaving.path, axis=0).T).sum())) > LONGEST_WAY:
            yield f"{approach.id}: {direction.name} is {length:.1f} m long"


def _turns(
    town: Town, approach: Approach, meant: Mapping[Command, tuple[float, float]], least: float, remedy: str = ""
) -> Iterator[str]:
    """Yield exits whose turn a direction does not name for sure, or that bend by less than a radius, metres."""
    for direction, leaving in approach.exits.items():
        turn = math.degrees(
            math.remainder(heading_of(town.lanes[leaving.lane].centreline[:2]) - approach.heading, math.tau)
        )
        low, high = meant[direction]
        if not low <= (abs(turn) if direction is Command.STRAIGHT else turn) <= high:
            yield f"angles: {direction.name} turns by {turn:.0f}°; {low:g} to {high:g} leave no doubt"
        if (radius := least_radius(leaving.path)) < least:
            yield f"radius: {direction.name} bends by {radius:.1f} m; {least:g} are needed{remedy}"


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
    yield from (f"{a} and {b} share {shared:.1f} m²" for (a, b), shared in _shared(town))


def _shared(town: Town) -> Iterator[tuple[tuple[str, str], float]]:
    """Yield pairs of lanes and junctions that cover the same ground, and how much of it, square metres."""
    names = [*town.lanes, *town.junctions]
    grounds = [*(lane.polygon for lane in town.lanes.values()), *(one.area for one in town.junctions.values())]
    for a, b in STRtree(grounds).query(grounds, predicate="intersects").T.tolist():
        one, other = town.lanes.get(names[a]), town.lanes.get(names[b])
        if one is not None and other is not None and one.edge == other.edge:
            continue
        most = _SEAM if one is not None and one.opposite == names[b] else _OVERLAP
        if a < b and (shared := grounds[a].intersection(grounds[b]).area) > most:
            yield (names[a], names[b]), shared
