"""The judge's geometry of one approach, with the town around it, and of a whole town for journeys."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from wrongturn_judge import kernels
from wrongturn_judge.packing import (
    Boxes,
    Floats,
    Grid,
    Marks,
    Packed,
    Packer,
    Surface,
    edges_of,
    pack,
    segments_of,
    with_boxes,
)
from wrongturn_networks import ways_to
from wrongturn_networks.per_net import once_per_net
from wrongturn_protocol import DIRECTIONS, Command, Trial

if TYPE_CHECKING:
    from wrongturn_networks import Town


@dataclasses.dataclass(frozen=True, eq=False)
class ExitLane:
    """The lane of an exit."""

    centreline: Floats
    """(n, 2), metres, starting at the exit line."""
    width: float
    """Metres."""


@dataclasses.dataclass(frozen=True, eq=False)
class LaneStrip:
    """A lane that begins or ends at the junction; a car may drive against its direction."""

    polygon: BaseGeometry
    centreline: Floats
    """(n, 2), metres, in the direction of travel."""


@dataclasses.dataclass(frozen=True, eq=False)
class JudgeGeometry:
    """All that a verdict needs to know about a town, as arrays and shapely polygons; metres, radians, town frame.

    :meth:`of` makes it from a town. It can also be made by hand.
    """

    road: BaseGeometry
    """Area where wheels may be."""
    area: BaseGeometry
    """Area of the trial's junction."""
    approach: Floats
    """Centre line of the approach's lane, (n, 2); its last point lies on the stop line."""
    exits: Mapping[Command, ExitLane]
    """Exits of this approach."""
    middle: tuple[float, float]
    """Middle of the junction."""
    street_axis: float
    """Distance of the approach street's axis from its lane's axis, positive to the left."""
    lanes: tuple[LaneStrip, ...] = ()
    """Car lanes that begin or end at the junction."""
    other_areas: tuple[BaseGeometry, ...] = ()
    """Areas of the town's other junctions."""
    width: float | None = None
    """Width of the approach's lane; None for a lane that reaches to the street's axis."""
    solids: Floats = dataclasses.field(default_factory=lambda: np.empty((0, 5)))
    """(n, 5): x, y, yaw, length, width of every solid box, trunks included."""
    town_sha256: str | None = None
    """Checksum of the town that it was made from; None if it was made by hand."""
    plain: JudgeGeometry | None = None
    """The same approach with the scenery that its town ships with. Both share what is packed of the net."""

    @classmethod
    def of(cls, town: Town, trial: Trial) -> JudgeGeometry:
        """Return the geometry of a trial's approach, made once for each. Raises UnknownApproachError."""
        return _geometry_of(town, trial.approach)

    @functools.cached_property
    def packed(self) -> Packed:
        """Arrays for the kernels."""
        plain = self.plain
        shared = plain is not None and all(getattr(self, name) is getattr(plain, name) for name in _OF_THE_NET)
        return with_boxes((plain if plain is not None and shared else self).net, _boxes(self.solids.tobytes()))

    @functools.cached_property
    def net(self) -> Packed:
        """Arrays for the kernels, without the solid boxes."""
        lanes_of_exits = (self.exits.get(direction) for direction in DIRECTIONS)
        return pack(
            _surface(self.road),
            (self.area, *self.other_areas),
            [(lane.polygon, lane.centreline) for lane in self.lanes],
            self.approach,
            2 * abs(self.street_axis) if self.width is None else self.width,
            [(lane.centreline, lane.width) if lane else None for lane in lanes_of_exits],
        )

    @functools.cached_property
    def stop_line(self) -> tuple[float, float, float, float]:
        """Middle of the stop line, and the unit vector across it into the junction."""
        ux, uy = segments_of(self.approach)[-1, 2:4].tolist()
        x, y = self.approach[-1].tolist()
        return x, y, ux, uy

    def beside_approach(self, x: float, y: float) -> tuple[float, float]:
        """Return how far a point is past the stop line and left of the lane's axis, both extended straight, metres."""
        stop_x, stop_y, ux, uy = self.stop_line
        dx, dy = x - stop_x, y - stop_y
        return dx * ux + dy * uy, dy * ux - dx * uy


_OF_THE_NET: Final = ("road", "area", "approach", "exits", "lanes", "other_areas")


# Approaches of a town share these. The keys are the shapes themselves, so a geometry whose road or boxes were replaced
# never gets those of another.
@functools.lru_cache(maxsize=16)
def _surface(road: BaseGeometry) -> Surface:
    return Surface.of(road)


@functools.lru_cache(maxsize=16)
def _boxes(solids: bytes) -> Boxes:
    return Boxes.of(np.frombuffer(solids, np.float64).reshape(-1, 5))


@functools.lru_cache(maxsize=16)
def _solids(town: Town) -> Floats:
    rows = [(thing.x, thing.y, thing.yaw, thing.length, thing.width) for thing in town.scenery if thing.solid]
    solids = np.array(rows, np.float64).reshape(-1, 5)
    solids.setflags(write=False)
    return solids


@functools.lru_cache(maxsize=256)
def _geometry_of(town: Town, approach_id: str) -> JudgeGeometry:
    if town.plain is not town:
        plain = _geometry_of(town.plain, approach_id)
        return dataclasses.replace(plain, solids=_solids(town), town_sha256=town.sha256, plain=plain)
    approach = town.approach(approach_id)
    junction = town.junctions[approach.junction]
    lane = town.lanes[approach.lane]
    return JudgeGeometry(
        road=town.road,
        area=junction.area,
        approach=lane.centreline,
        exits=MappingProxyType(
            {
                direction: ExitLane(town.lanes[leaving.lane].middle, town.lanes[leaving.lane].breadth)
                for direction, leaving in approach.exits.items()
            }
        ),
        middle=(float(junction.position[0]), float(junction.position[1])),
        street_axis=lane.axis,
        width=lane.width,
        lanes=tuple(
            LaneStrip(one.polygon, one.centreline)
            for one in town.lanes.values()
            if approach.junction in {one.start_junction, one.end_junction}
        ),
        other_areas=tuple(other.area for name, other in town.junctions.items() if name != approach.junction),
        solids=_solids(town),
        town_sha256=town.sha256,
    )


class JourneyGeometry:
    """The geometry of a town for judging journeys; metres, radians, town frame. :meth:`of` makes it once for each town.

    Lanes are numbered in the town's order.
    """

    def __init__(self, town: Town) -> None:
        self.town = town
        self.town_sha256 = town.sha256
        self.rows = {name: row for row, name in enumerate(town.lanes)}
        """Number of each lane, by its id."""
        net, self.lanes = _packed_net(town)
        self.packed = with_boxes(net, _boxes(_solids(town).tobytes()))
        """Arrays for the kernels. ``lanes`` has a number for each cell of the surface: 0 for no lane; a lane's number
        plus 1; or, on a boundary, -1 minus the row of ``candidates`` that lists the lanes to compare."""
        self._rests: dict[str, Floats] = {}

    @classmethod
    def of(cls, town: Town) -> JourneyGeometry:
        """Return the geometry of a town."""
        return _journeys_of(town)

    def rest(self, goal: str) -> Floats:
        """Return metres from each lane's end to the goal's lane, or inf. Raises UnknownLaneError."""
        if goal not in self._rests:
            self._rests[goal] = _rest(self.town, self.rows, goal)
        return self._rests[goal]


@functools.lru_cache(maxsize=16)
def _journeys_of(town: Town) -> JourneyGeometry:
    return JourneyGeometry(town)


def _rest(town: Town, rows: dict[str, int], goal: str) -> Floats:
    rest = np.full(len(rows), math.inf)
    for name, way in ways_to(town, goal).items():
        rest[rows[name]] = way.metres - town.lanes[name].length
    rest.setflags(write=False)
    return rest


@once_per_net(16)
def _packed_net(town: Town) -> tuple[Packed, NDArray[np.int16]]:
    """Return the arrays of a town without its solid boxes, and the lane of each cell."""
    rows = {name: row for row, name in enumerate(town.lanes)}
    surface = _surface(town.road)
    grid = surface.grid
    packer = Packer(surface)
    areas = [edges_of(junction.area) for junction in town.junctions.values()]
    packer.add_areas(areas)
    cells = np.zeros((grid.rows, grid.columns), np.uint8)
    for marks, code in (("covered", kernels.AREA_OWN), ("touched", kernels.AREA_EDGE)):
        for edges in areas:
            part, where = grid.part(edges)
            cells[where][getattr(part, marks)(edges)] = code

    edges_by_row = [edges_of(lane.polygon) for lane in town.lanes.values()]
    packer.add_lanes(zip(edges_by_row, (lane.centreline for lane in town.lanes.values()), strict=True))
    lanes, candidates = _lane_cells(grid, edges_by_row)
    packer.head.candidates = packer.add_ints(candidates)
    packer.head.candidates_width = candidates.shape[1]
    onward = np.full((len(rows), 3), -1, np.int64)
    for name, row in rows.items():
        approach = town.approach_of_lane(name)
        for k, leaving in enumerate(approach.exits.values() if approach is not None else ()):
            onward[row, k] = rows[leaving.lane]
    packer.head.onward = packer.add_ints(onward)
    return packer.packed(surface.codes | (cells << 2)), lanes


def _lane_cells(grid: Grid, lanes: list[Floats]) -> tuple[NDArray[np.int16], NDArray[np.int64]]:
    """Return the lane of each cell, and for each cell on a boundary its candidates, padded with -1."""
    there = np.zeros((grid.rows, grid.columns), np.int16)
    bounds: Marks = np.zeros((grid.rows, grid.columns), np.bool_)
    near: dict[tuple[int, int], list[int]] = {}
    for row, edges in enumerate(lanes):
        part, where = grid.part(edges)
        inner, edge = part.covered(edges), part.touched(edges)
        there[where][inner] = row + 1
        bounds[where] |= edge
        for i, k in np.argwhere(inner | edge).tolist():
            near.setdefault((where[0].start + i, where[1].start + k), []).append(row)
    listed = [near[i, k] for i, k in np.argwhere(bounds).tolist()]
    width = max((len(one) for one in listed), default=1)
    candidates = np.array([one + [-1] * (width - len(one)) for one in listed], np.int64).reshape(-1, width)
    there[bounds] = -1 - np.arange(len(listed))
    cells: NDArray[np.int16] = np.ravel(there)
    cells.setflags(write=False)
    return cells, candidates
