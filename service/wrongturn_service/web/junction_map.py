"""Junction maps: all trials of one junction type and fault, drawn in one frame.

The frame's origin is the junction's node, where the streets' centre lines meet, and the car drives in from below. So
all approaches of a type lie on each other. Lengths are metres, x to the right and y down, as SVG has them.
"""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple, Self

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.affinity import affine_transform
from shapely.geometry.base import BaseGeometry

from wrongturn_networks import Town, load_town
from wrongturn_protocol import DIRECTIONS, FaultKind, JunctionType, Outcome, Safety, Trial, Verdict
from wrongturn_service.web import words

Points = NDArray[np.float64]
"""Points (n, 2), metres."""

LEFT, TOP, RIGHT, BOTTOM = -34.0, -34.0, 34.0, 34.0
"""What a map shows, metres. Cars that take an exit end 27 to 30 m from the node."""
_REACH: Final = 70.0
"""Roads farther from the node than this are left out, metres: beyond the map's corners."""
_DETAIL: Final = 0.15
"""Drawn paths are this near to the driven ones, metres."""
_INSET: Final = 1.5
"""Marks of paths that leave the map stand this far inside its border, metres."""

MARKS: Final = {
    Verdict.COLLISION: "star",
    Verdict.OFF_ROAD: "cross",
    Verdict.STOPPED_IN_JUNCTION: "block",
    Verdict.WRONG_WAY: "triangle",
    Verdict.STOPPED_BEFORE_JUNCTION: "bar",
    Verdict.EXIT_COMMANDED: "dot",
    Verdict.EXIT_ROUTE: "dot",
    Verdict.EXIT_OTHER: "dot",
}
"""Shape at the end of a path, by verdict."""
NEUTRAL_MARK: Final = "diamond"
"""Shape of the other verdicts."""


@dataclass(frozen=True)
class Frame:
    """The map's frame at one approach.

    Attributes:
        origin: The junction's node, metres, town frame.
        heading: Heading of the approach's lane at the stop line, radians.
    """

    origin: tuple[float, float]
    heading: float

    @classmethod
    def of(cls, town: Town, approach_id: str) -> Self:
        """Return the frame of an approach. Raises UnknownApproachError."""
        approach = town.approach(approach_id)
        return cls(town.junctions[approach.junction].position, approach.heading)

    def draw(self, points: Points) -> Points:
        """Return points (n, 2) of the town's frame in the map's."""
        east, north = points[:, 0] - self.origin[0], points[:, 1] - self.origin[1]
        cos, sin = math.cos(self.heading), math.sin(self.heading)
        return np.column_stack((east * sin - north * cos, -(east * cos + north * sin)))

    def draw_area(self, area: BaseGeometry) -> BaseGeometry:
        """Return an area of the town's frame in the map's."""
        cos, sin = math.cos(self.heading), math.sin(self.heading)
        x, y = self.origin
        return affine_transform(area, [sin, -cos, -cos, -sin, y * cos - x * sin, x * cos + y * sin])


class Driven(NamedTuple):
    """A finished episode at a junction."""

    episode: str
    """Id of the episode."""
    trial: Trial
    outcome: Outcome
    path: Points | None
    """(n, 2), metres, town frame: where the car's centre was. None for an episode without a trajectory."""


class Drawn(NamedTuple):
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


class Arm(NamedTuple):
    """A label at an exit."""

    direction: str
    trials: int


@dataclass(frozen=True)
class Ground:
    """What lies under the paths, as SVG's path data."""

    somewhere: str
    """Road at one of the approaches at least."""
    everywhere: str
    """Road at all of the approaches."""
    stop_lines: str


@dataclass(frozen=True)
class JunctionMap:
    """All trials of one junction type and fault."""

    junction_type: JunctionType
    fault: FaultKind
    ground: Ground
    paths: tuple[Drawn, ...]
    """Unsafe ones last, so that they lie on top."""
    shares: tuple[Share, ...]
    """Their trials add up to ``trials``."""
    arms: tuple[Arm, ...]
    """The exits that this type has."""
    trials: int
    unsafe: int
    """Unsafe trials in the strict column."""


def junction_map(
    junction_type: JunctionType, fault: FaultKind, approaches: Iterable[tuple[str, str]], driven: Sequence[Driven]
) -> JunctionMap:
    """Draw episodes on one map.

    Args:
        junction_type: The type of all trials.
        fault: The fault of all trials.
        approaches: Town and approach of every junction whose road is drawn.
        driven: The episodes.
    """
    order = (Safety.SAFE, Safety.NEITHER, Safety.UNSAFE)
    paths = [drawn for episode in driven if (drawn := _drawn(episode)) is not None]
    outcomes = [episode.outcome for episode in driven]
    exits = Counter(outcome.exit for outcome in outcomes if outcome.verdict.exited)
    return JunctionMap(
        junction_type=junction_type,
        fault=fault,
        ground=ground(frozenset(approaches)),
        paths=tuple(sorted(paths, key=lambda path: order.index(path.side))),
        shares=shares(outcomes),
        arms=tuple(Arm(word.name.lower(), exits[word]) for word in DIRECTIONS if word in junction_type.exits),
        trials=len(driven),
        unsafe=sum(words.side(outcome) is Safety.UNSAFE for outcome in outcomes),
    )


def mark(verdict: Verdict) -> str:
    """Return the name of a verdict's shape."""
    return MARKS.get(verdict, NEUTRAL_MARK)


def shares(outcomes: Iterable[Outcome]) -> tuple[Share, ...]:
    """Return how many outcomes ended in each way, the most frequent first."""
    counts = Counter((words.ending(one.verdict, one.exit), words.side(one), mark(one.verdict)) for one in outcomes)
    return tuple(Share(*key, count) for key, count in sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def path_data(points: Points) -> str:
    """Return points (n, 2) as SVG's path data, without those that a straight line replaces."""
    kept = (
        shapely.get_coordinates(shapely.simplify(shapely.linestrings(points), _DETAIL)) if len(points) > 1 else points
    )
    return "M" + " ".join(f"{x:.1f},{y:.1f}" for x, y in kept.tolist())


def _drawn(driven: Driven) -> Drawn | None:
    if driven.path is None or not len(driven.path):
        return None
    trial, outcome = driven.trial, driven.outcome
    points = _frame(trial.town, trial.approach).draw(driven.path)
    x, y = points[-1].tolist()
    end = (
        min(max(x, LEFT + _INSET), RIGHT - _INSET),
        min(max(y, TOP + _INSET), BOTTOM - _INSET),
    )
    title = f"{trial.town} {trial.approach}, {words.name(outcome.verdict)}. {words.told(trial)} {words.ended(outcome)}"
    return Drawn(driven.episode, path_data(points), end, words.side(outcome), mark(outcome.verdict), title)


@lru_cache(maxsize=1024)
def _frame(town: str, approach: str) -> Frame:
    return Frame.of(load_town(town), approach)


@lru_cache(maxsize=64)
def ground(approaches: frozenset[tuple[str, str]]) -> Ground:
    """Return the roads of approaches, each given by town and id, on each other."""
    roads = [_road(town, approach) for town, approach in sorted(approaches)]
    stop_lines = [_stop_line(town, approach) for town, approach in sorted(approaches)]
    return Ground(
        somewhere=_area_data(shapely.union_all(roads)),
        everywhere=_area_data(shapely.intersection_all(roads)),
        stop_lines=" ".join(stop_lines),
    )


@lru_cache(maxsize=1024)
def _road(town_name: str, approach: str) -> BaseGeometry:
    town = load_town(town_name)
    frame = Frame.of(town, approach)
    x, y = frame.origin
    near = shapely.clip_by_rect(town.road, x - _REACH, y - _REACH, x + _REACH, y + _REACH)
    shown = shapely.clip_by_rect(frame.draw_area(near), LEFT, TOP, RIGHT, BOTTOM)
    return shapely.make_valid(shown)


def _stop_line(town_name: str, approach_id: str) -> str:
    town = load_town(town_name)
    approach = town.approach(approach_id)
    half = town.lanes[approach.lane].width / 2
    across = np.array([-math.sin(approach.heading), math.cos(approach.heading)]) * half
    ends = np.array(approach.stop_line) + np.array([across, -across])
    return path_data(Frame.of(town, approach_id).draw(ends))


def _area_data(area: BaseGeometry) -> str:
    rings = [
        ring
        for part in getattr(area, "geoms", [area])
        if isinstance(part, shapely.Polygon) and not part.is_empty
        for ring in (part.exterior, *part.interiors)
    ]
    return " ".join(f"{path_data(shapely.get_coordinates(ring))}Z" for ring in rings)
