"""The judge's geometry of one approach: polygons, lines and boxes of the town around it."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from shapely.geometry.base import BaseGeometry

from wrongturn_judge.packing import Boxes, Floats, Packed, Surface, pack, segments_of
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
    solids: Floats = dataclasses.field(default_factory=lambda: np.empty((0, 5)))
    """(n, 5): x, y, yaw, length, width of every solid box, trunks included."""
    town_sha256: str | None = None
    """Checksum of the town that it was made from; None if it was made by hand."""

    @classmethod
    def of(cls, town: Town, trial: Trial) -> JudgeGeometry:
        """Return the geometry of a trial's approach; it is made once for each approach.

        Raises:
            UnknownApproachError: the town has no such approach.
        """
        return _geometry_of(town, trial.approach)

    @functools.cached_property
    def packed(self) -> Packed:
        """Arrays for the kernels."""
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
        """Middle of the stop line, and the unit vector across it into the junction."""
        ux, uy = segments_of(self.approach)[-1, 2:4].tolist()
        x, y = self.approach[-1].tolist()
        return x, y, ux, uy

    def beside_approach(self, x: float, y: float) -> tuple[float, float]:
        """Return how far a point is past the stop line and left of the lane's axis, both extended straight, metres."""
        stop_x, stop_y, ux, uy = self.stop_line
        dx, dy = x - stop_x, y - stop_y
        return dx * ux + dy * uy, dy * ux - dx * uy


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


def surface_of_town(town: Town) -> tuple[Surface, Boxes]:
    """Return a town's road and solid boxes on their grids, which the geometries of its approaches share."""
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
