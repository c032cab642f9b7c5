"""Towns: road networks with their junctions, roads and scenery."""

import dataclasses
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from shapely import set_precision
from shapely.geometry import mapping
from shapely.geometry.base import BaseGeometry

from wrongturn_networks.errors import UnknownApproachError
from wrongturn_networks.junctions import Approach, Junction
from wrongturn_networks.lanes import Lane
from wrongturn_networks.scenery import SceneryObject, scenery_toml
from wrongturn_protocol import ApproachDetail, FaultKind, JunctionType, TownDetail, TownSummary


@dataclass(frozen=True, eq=False)
class Town:
    """A road network and its scenery. Metres, x east, y north; headings in radians from east."""

    name: str
    directory: Path
    net_file: Path
    """SUMO's network file."""
    net_sha256: str
    """Checksum of the canonical network."""
    sha256: str
    """Checksum of the canonical network and the scenery."""
    lanes: Mapping[str, Lane]
    """Car lanes between junctions, by id."""
    junctions: Mapping[str, Junction]
    approaches: Mapping[str, Approach]
    road: BaseGeometry
    """Area where a car may be."""
    sidewalks: BaseGeometry
    scenery: tuple[SceneryObject, ...]
    bounds: tuple[float, float, float, float]
    """Least x, least y, greatest x, greatest y of road and sidewalks."""
    scenery_seed: int | None = None
    """Seed of its drawn scenery; None for the scenery that it ships with."""
    closed: tuple[str, ...] = ()
    """Ids of lanes that boards close; the boards are part of the scenery."""
    shipped: "Town | None" = None
    """The town that its scenery was drawn for, or that it was before boards; None for that town itself."""

    @property
    def plain(self) -> "Town":
        """The town with the scenery that it ships with. What depends on the net alone is made once, of this one."""
        return self.shipped or self

    def with_scenery(self, scenery: tuple[SceneryObject, ...], seed: int) -> "Town":
        """Return the town with other scenery, which was drawn from a seed."""
        found = hashlib.sha256(scenery_toml(scenery).encode()).hexdigest()
        return dataclasses.replace(
            self.plain,
            scenery=scenery,
            sha256=sha256_of_town(self.net_sha256, found),
            scenery_seed=seed,
            shipped=self.plain,
        )

    def approach(self, approach_id: str) -> Approach:
        """Return an approach by its id. Raises UnknownApproachError, which lists the known ones."""
        if approach_id not in self.approaches:
            raise UnknownApproachError(approach_id, self.approaches)
        return self.approaches[approach_id]

    def approach_of_lane(self, lane_id: str) -> Approach | None:
        """Return the approach of a lane; None if the lane ends at no junction."""
        return self._by_lane.get(lane_id)

    @cached_property
    def _by_lane(self) -> dict[str, Approach]:
        return {approach.lane: approach for approach in self.approaches.values()}

    def summary(self) -> TownSummary:
        """Return the town as the service lists it."""
        counts = dict.fromkeys(JunctionType, 0)
        for approach in self.approaches.values():
            counts[approach.type] += 1
        return TownSummary(
            name=self.name,
            sha256=self.sha256,
            junctions=len(self.junctions),
            approaches={kind: count for kind, count in counts.items() if count},
        )

    def detail(self, faults: Mapping[str, tuple[FaultKind, ...]]) -> TownDetail:
        """Return the town as the service describes it: enough to draw it. ``faults`` are those of each approach."""
        return TownDetail(
            name=self.name,
            sha256=self.sha256,
            bounds=self.bounds,
            approaches=tuple(
                ApproachDetail(
                    id=approach.id,
                    junction=approach.junction,
                    type=approach.type,
                    exits=tuple(approach.exits),
                    faults=faults.get(approach.id, ()),
                    stop_line=approach.stop_line,
                    heading=approach.heading,
                    lane_length=self.lanes[approach.lane].length,
                )
                for approach in self.approaches.values()
            ),
            road=_geojson(self.road),
            junctions={junction.id: _geojson(junction.area) for junction in self.junctions.values()},
            lanes={lane.id: tuple((float(x), float(y)) for x, y in lane.centreline) for lane in self.lanes.values()},
        )


def sha256_of_town(net_sha256: str, scenery_sha256: str) -> str:
    """Return the checksum of a town from those of its canonical network and of its scenery's file."""
    return hashlib.sha256(f"{net_sha256} {scenery_sha256}".encode()).hexdigest()


def _geojson(geometry: BaseGeometry) -> dict[str, Any]:
    return dict(mapping(set_precision(geometry, 0.001)))
