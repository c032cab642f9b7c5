"""Junction maps: all trials of one junction type and fault, drawn in one frame.

The frame's origin is the junction's node, where the streets' centre lines meet, and the car drives in from below. So
all approaches of a type lie on each other. Lengths are metres, x to the right and y down, as SVG has them.
"""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import lru_cache, partial
from typing import Final, NamedTuple

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from wrongturn_networks import Town, load_town
from wrongturn_protocol import DIRECTIONS, FaultKind, JunctionType, Outcome, Safety
from wrongturn_protocol.junction_frame import Frame, Points, shape
from wrongturn_service.storage.finished import FinishedEpisode
from wrongturn_service.web import words

LEFT, TOP, RIGHT, BOTTOM = -34.0, -34.0, 34.0, 34.0
"""What a map shows, metres. Cars that take an exit end 27 to 30 m from the node."""
_REACH: Final = 70.0
"""Roads farther from the node than this are left out, metres: beyond the map's corners."""
_DETAIL: Final = 0.15
"""Drawn paths are this near to the driven ones, metres."""
_INSET: Final = 1.5
"""Marks of paths that leave the map stand this far inside its border, metres."""
_ORDER: Final = (Safety.SAFE, Safety.NEITHER, Safety.UNSAFE)
Driven = tuple[FinishedEpisode, Points | None]
"""An episode, and (n, 2), metres, town frame: where the car's centre was. None without a trajectory."""


class DrawnPath(NamedTuple):
    """A path on a map."""

    episode: str
    d: str
    """Path of the car's centre, as SVG writes it."""
    end: tuple[float, float]
    """Where the mark of its end stands."""
    side: Safety
    mark: str
    title: str
    """What happened, in words."""


class Share(NamedTuple):
    """The trials that ended in one way."""

    ending: str
    side: Safety
    mark: str
    trials: int


class Ground(NamedTuple):
    """What lies under the paths, as SVG's path data."""

    somewhere: str
    """Road at one of the approaches at least."""
    everywhere: str
    """Road at all of the approaches."""
    stop_lines: str


class JunctionMap(NamedTuple):
    """All trials of one junction type and fault."""

    junction_type: JunctionType
    fault: FaultKind
    ground: Ground
    paths: tuple[DrawnPath, ...]
    """Unsafe ones last, so that they lie on top."""
    shares: tuple[Share, ...]
    """Their trials add up to ``trials``."""
    arms: tuple[tuple[str, int], ...]
    """The exits that this type has, and how many trials ended in each."""
    trials: int
    unsafe: int
    """Unsafe trials in the strict column."""


def junction_map(
    junction_type: JunctionType, fault: FaultKind, approaches: Iterable[tuple[str, str]], driven: Sequence[Driven]
) -> JunctionMap:
    """Draw episodes of one type and fault on one map, over the roads of approaches, each given by town and id."""
    paths = [_drawn(episode, path) for episode, path in driven if path is not None and len(path)]
    outcomes = [episode.outcome for episode, _ in driven]
    exits = Counter(outcome.exit for outcome in outcomes if outcome.verdict.exited)
    return JunctionMap(
        junction_type=junction_type,
        fault=fault,
        ground=ground(frozenset(approaches)),
        paths=tuple(sorted(paths, key=lambda path: _ORDER.index(path.side))),
        shares=shares(outcomes),
        arms=tuple((word.name.lower(), exits[word]) for word in DIRECTIONS if word in junction_type.exits),
        trials=len(driven),
        unsafe=sum(words.side(outcome) is Safety.UNSAFE for outcome in outcomes),
    )


def shares(outcomes: Iterable[Outcome]) -> tuple[Share, ...]:
    """Return how many outcomes ended in each way, the most frequent first."""
    counts = Counter((words.ending(one.verdict, one.exit), words.side(one), shape(one.verdict)) for one in outcomes)
    return tuple(Share(*key, count) for key, count in sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def path_data(points: Points) -> str:
    """Return points (n, 2) as SVG's path data, without those that a straight line replaces."""
    if len(points) > 1:
        points = shapely.get_coordinates(shapely.simplify(shapely.linestrings(points), _DETAIL))
    return "M" + " ".join(f"{x:.1f},{y:.1f}" for x, y in points.tolist())


def _drawn(episode: FinishedEpisode, path: Points) -> DrawnPath:
    trial, outcome = episode.trial, episode.outcome
    points = on_map(frame_of(load_town(trial.town), trial.approach), path)
    x, y = np.clip(points[-1], (LEFT + _INSET, TOP + _INSET), (RIGHT - _INSET, BOTTOM - _INSET)).tolist()
    title = f"{trial.town} {trial.approach}, {words.name(outcome.verdict)}. {words.told(trial)} {words.ended(outcome)}"
    return DrawnPath(episode.id, path_data(points), (x, y), words.side(outcome), shape(outcome.verdict), title)


@lru_cache(maxsize=1024)
def frame_of(town: Town, approach_id: str) -> Frame:
    """Return the frame of an approach, with the junction's node at (0, 0). Raises UnknownApproachError."""
    approach = town.approach(approach_id)
    return Frame(town.junctions[approach.junction].position, approach.heading)


def on_map(frame: Frame, points: Points) -> Points:
    """Return points (n, 2) of the town's frame on the map, where y is down."""
    return frame.turned(points) * (1.0, -1.0)


@lru_cache(maxsize=64)
def ground(approaches: frozenset[tuple[str, str]]) -> Ground:
    """Return the roads of approaches, each given by town and id, on each other."""
    roads = [_road(town, approach) for town, approach in sorted(approaches)]
    return Ground(
        somewhere=_area_data(shapely.union_all(roads)),
        everywhere=_area_data(shapely.intersection_all(roads)),
        stop_lines=" ".join(_stop_line(town, approach) for town, approach in sorted(approaches)),
    )


@lru_cache(maxsize=1024)
def _road(town_name: str, approach: str) -> BaseGeometry:
    town = load_town(town_name)
    frame = frame_of(town, approach)
    x, y = frame.origin
    near = shapely.clip_by_rect(town.road, x - _REACH, y - _REACH, x + _REACH, y + _REACH)
    shown = shapely.clip_by_rect(shapely.transform(near, partial(on_map, frame)), LEFT, TOP, RIGHT, BOTTOM)
    return shapely.make_valid(shown)


def _stop_line(town_name: str, approach_id: str) -> str:
    town = load_town(town_name)
    approach = town.approach(approach_id)
    half = town.lanes[approach.lane].width / 2
    across = np.array([-math.sin(approach.heading), math.cos(approach.heading)]) * half
    ends = np.array(approach.stop_line) + np.array([across, -across])
    return path_data(on_map(frame_of(town, approach_id), ends))


def _area_data(area: BaseGeometry) -> str:
    rings = [
        ring
        for part in getattr(area, "geoms", [area])
        if isinstance(part, shapely.Polygon) and not part.is_empty
        for ring in (part.exterior, *part.interiors)
    ]
    return " ".join(f"{path_data(shapely.get_coordinates(ring))}Z" for ring in rings)
