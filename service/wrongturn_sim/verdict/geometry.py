"""What the judge knows of a town: plain polygons, lines and boxes around one approach."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from shapely import affinity
from shapely.geometry.base import BaseGeometry

from wrongturn_protocol import DIRECTIONS, Command, Trial
from wrongturn_sim.verdict.packing import Boxes, Floats, Packed, Surface, pack, segments_of

if TYPE_CHECKING:
    from wrongturn_networks import Town

MIRRORED = {Command.LEFT: Command.RIGHT, Command.RIGHT: Command.LEFT, Command.STRAIGHT: Command.STRAIGHT}
"""What a direction becomes in a mirror."""


@dataclasses.dataclass(frozen=True, eq=False)
class ExitLane:
    """The lane by which an exit leaves the junction."""

    centreline: Floats
    """(n, 2), metres, from the exit line on."""
    width: float
    """Metres."""


@dataclasses.dataclass(frozen=True, eq=False)
class LaneStrip:
    """A lane that begins or ends at the junction: where a car may be on the wrong side."""

    polygon: BaseGeometry
    centreline: Floats
    """(n, 2), metres, in the direction of travel."""


@dataclasses.dataclass(frozen=True, eq=False)
class JudgeGeometry:
    """Everything that a verdict needs of the town, as arrays and shapely polygons; metres and radians, town frame.

    It can be made by hand, and :meth:`mirrored`; :meth:`of` takes it from a town.
    """

    road: BaseGeometry
    """Where wheels may be."""
    area: BaseGeometry
    """The trial's junction area."""
    approach: Floats
    """Centre line of the incoming lane, (n, 2); its last point lies on the stop line."""
    exits: Mapping[Command, ExitLane]
    """Those that are permitted from this approach."""
    middle: tuple[float, float]
    """The junction's."""
    street_axis: float
    """Where the approach street's axis lies beside the incoming lane's, positive to the left."""
    lanes: tuple[LaneStrip, ...] = ()
    """All lanes for cars that begin or end at the junction."""
    other_areas: tuple[BaseGeometry, ...] = ()
    """The areas of the town's other junctions."""
    solids: Floats = dataclasses.field(default_factory=lambda: np.empty((0, 5)))
    """(n, 5): x, y, yaw, length, width of every solid box; a trunk is one too."""
    town_sha256: str | None = None
    """Of the town that it was taken from; None if it was made by hand."""

    @classmethod
    def of(cls, town: Town, trial: Trial) -> JudgeGeometry:
        """The geometry of a trial's approach; made once for each approach.

        Raises:
            UnknownApproachError: the town has no such approach.
        """
        return _geometry_of(town, trial.approach)

    @functools.cached_property
    def packed(self) -> Packed:
        """The arrays that the kernels read."""
        lanes_of_exits = (self.exits.get(direction) for direction in DIRECTIONS)
        return pack(
            _surface(self.road),
            _boxes(self.solids.tobytes()),
            (self.area, *self.other_areas),
            [(lane.polygon, lane.centreline) for lane in self.lanes],
            self.approach,
            [(lane.centreline, lane.width) if lane else None for lane in lanes_of_exits],
        )

    @functools.cached_property
    def stop_line(self) -> tuple[float, float, float, float]:
        """The stop line's middle and the unit vector across it, into the junction."""
        ux, uy = segments_of(self.approach)[-1, 2:4].tolist()
        x, y = self.approach[-1].tolist()
        return x, y, ux, uy

    def beside_approach(self, x: float, y: float) -> tuple[float, float]:
        """A point as metres past the stop line and metres left of the incoming lane's axis, both drawn on straight."""
        stop_x, stop_y, ux, uy = self.stop_line
        dx, dy = x - stop_x, y - stop_y
        return dx * ux + dy * uy, dy * ux - dx * uy

    def mirrored(self) -> JudgeGeometry:
        """The same in a mirror along the x axis: y becomes -y, left becomes right."""
        flip = np.array([1.0, -1.0])
        solids = self.solids * np.array([1.0, -1.0, -1.0, 1.0, 1.0])
        return dataclasses.replace(
            self,
            road=_flipped(self.road),
            area=_flipped(self.area),
            approach=self.approach * flip,
            exits={
                MIRRORED[direction]: ExitLane(lane.centreline * flip, lane.width)
                for direction, lane in self.exits.items()
            },
            middle=(self.middle[0], -self.middle[1]),
            street_axis=-self.street_axis,
            lanes=tuple(LaneStrip(_flipped(lane.polygon), lane.centreline * flip) for lane in self.lanes),
            other_areas=tuple(_flipped(area) for area in self.other_areas),
            solids=solids,
            town_sha256=None,
        )


def _flipped(shape: BaseGeometry) -> BaseGeometry:
    return affinity.scale(shape, 1.0, -1.0, origin=(0.0, 0.0))


# What all approaches of a town have in common is made once; the keys are the shapes themselves, so that a geometry
# whose road or boxes were replaced never sees those of another.
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


def surface_of_town(town: Town) -> tuple[Surface, Boxes]:
    """A town's road and solid boxes on their grids, shared with the geometries of its approaches."""
    return _surface(town.road), _boxes(_solids(town).tobytes())


@functools.lru_cache(maxsize=256)
def _geometry_of(town: Town, approach_id: str) -> JudgeGeometry:
    approach = town.approach(approach_id)
    junction = town.junctions[approach.junction]
    lane = town.lanes[approach.lane]
    return JudgeGeometry(
        road=town.road,
        area=junction.area,
        approach=lane.centreline,
        exits=MappingProxyType(
            {
                direction: ExitLane(town.lanes[leaving.lane].centreline, town.lanes[leaving.lane].width)
                for direction, leaving in approach.exits.items()
            }
        ),
        middle=(float(junction.position[0]), float(junction.position[1])),
        street_axis=lane.width / 2,  # right-hand traffic: the street's axis is the lane's left side
        lanes=tuple(
            LaneStrip(one.polygon, one.centreline)
            for one in town.lanes.values()
            if approach.junction in {one.start_junction, one.end_junction}
        ),
        other_areas=tuple(other.area for name, other in town.junctions.items() if name != approach.junction),
        solids=_solids(town),
        town_sha256=town.sha256,
    )
