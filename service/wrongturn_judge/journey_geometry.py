"""The geometry of a whole town for judging journeys, as the flat arrays that the kernels read."""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from wrongturn_judge import kernels
from wrongturn_judge.geometry import surface_of_town
from wrongturn_judge.packing import Floats, Grid, Marks, Packed, Packer, edges_of
from wrongturn_networks import ways_to

if TYPE_CHECKING:
    from wrongturn_networks import Town


class JourneyGeometry:
    """The geometry of a town for judging journeys; metres, radians, town frame. :meth:`of` makes it once for each town.

    Lanes are numbered in the town's order.
    """

    def __init__(self, town: Town) -> None:
        self.town = town
        self.town_sha256 = town.sha256
        self.rows = {name: row for row, name in enumerate(town.lanes)}
        """Number of each lane, by its id."""
        self.packed, self.lanes = _packed(town, self.rows)
        """Arrays for the kernels. ``lanes`` has a number for each cell of the surface: 0 for no lane; a lane's number
        plus 1; or, on a boundary, -1 minus the row of ``candidates`` that lists the lanes to compare."""
        self._rests: dict[str, Floats] = {}

    @classmethod
    def of(cls, town: Town) -> JourneyGeometry:
        """Return the geometry of a town."""
        return _geometry_of(town)

    def rest(self, goal: str) -> Floats:
        """Return metres from each lane's end to the start of the goal's lane by the shortest way; inf if none.

        Raises:
            UnknownLaneError: the town has no such lane.
        """
        if goal not in self._rests:
            self._rests[goal] = _rest(self.town, self.rows, goal)
        return self._rests[goal]


@functools.lru_cache(maxsize=16)
def _geometry_of(town: Town) -> JourneyGeometry:
    return JourneyGeometry(town)


def _rest(town: Town, rows: dict[str, int], goal: str) -> Floats:
    rest = np.full(len(rows), math.inf)
    for name, way in ways_to(town, goal).items():
        rest[rows[name]] = way.metres - town.lanes[name].length
    rest.setflags(write=False)
    return rest


def _packed(town: Town, rows: dict[str, int]) -> tuple[Packed, NDArray[np.int16]]:
    surface, boxes = surface_of_town(town)
    grid = surface.grid
    packer = Packer(surface, boxes)
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
