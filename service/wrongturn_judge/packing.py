"""Packing of shapes into the flat arrays that the kernels read.

Two grids save the kernels from searching. The first has one byte for each square metre of the town: road, junction
area, lane, or a boundary of one of them, where the polygon's edges decide. The second has cells of 4 m. Each lists the
solid boxes that a car may touch from within the cell or from up to half a stride beside it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from wrongturn_judge import kernels
from wrongturn_judge.marking import mark_edges, mark_inside
from wrongturn_judge.thresholds import Thresholds
from wrongturn_protocol import VEHICLE

Floats = NDArray[np.float64]
Marks = NDArray[np.bool_]

CLOCK_TOLERANCE = 1e-6
"""A duration that is short by this much counts as reached, s: sums of 0.05 s are not exact in binary."""
SLACK = 1e-6
"""Greatest error of a computed crossing, m."""
REACH = 3.0
"""Greatest distance from a body's centre to its corners that the boxes' grid allows, m."""


@dataclasses.dataclass(frozen=True, eq=False)
class Packed:
    """A geometry as read-only flat arrays."""

    floats: Floats
    ints: NDArray[np.int64]
    cells: NDArray[np.uint8]


def edges_of(geometry: BaseGeometry) -> Floats:
    """Return the edges of one or more polygons, holes included, (n, 4): x1, y1, x2, y2."""
    runs = [np.empty((0, 4))]
    for ring in shapely.get_rings(shapely.get_parts(geometry)):
        points = shapely.get_coordinates(ring)
        runs.append(np.hstack([points[:-1], points[1:]]))
    edges: Floats = np.concatenate(runs)
    whole: Floats = edges[(edges[:, :2] != edges[:, 2:]).any(axis=1)]
    return whole


def segments_of(line: Floats) -> Floats:
    """Return the segments of a polyline (n, 2), without empty ones, (m, 6): x, y, unit vector, length, arc length."""
    rows = []
    s = 0.0
    for (x1, y1), (x2, y2) in zip(line[:-1].tolist(), line[1:].tolist(), strict=True):
        length = math.sqrt((x2 - x1) * (x2 - x1) + (y2 - y1) * (y2 - y1))
        if length > 0.0:
            rows.append((x1, y1, (x2 - x1) / length, (y2 - y1) / length, length, s))
            s += length
    return np.array(rows, np.float64).reshape(-1, kernels.SEGMENT)


def boxes_of(solids: Floats) -> Floats:
    """Return boxes (n, 7) for solids (n, 5), which are x, y, yaw, length, width."""
    boxes = np.empty((len(solids), kernels.BOX))
    for box, (x, y, yaw, length, width) in zip(boxes, solids.tolist(), strict=True):
        radius = math.sqrt(length * length + width * width) / 2
        box[:] = x, y, math.cos(yaw), math.sin(yaw), length / 2, width / 2, radius
    return boxes


class Packer:
    """Collects floats and ints; its methods return where each added list begins."""

    def __init__(self) -> None:
        self.floats: list[Floats] = [np.zeros(kernels.FLOATS)]
        self.ints: list[NDArray[np.int64]] = [np.zeros(kernels.INTS, np.int64)]

    def add_floats(self, values: Floats) -> int:
        """Append a list and return its start."""
        begin = sum(map(len, self.floats))
        self.floats.append(np.ascontiguousarray(values, np.float64).ravel())
        return begin

    def add_polygon(self, edges: Floats) -> int:
        """Append slightly widened bounds, then the edges, and return the edges' start."""
        corners = edges.reshape(-1, 2) if len(edges) else np.zeros((1, 2))
        self.add_floats(np.concatenate([corners.min(axis=0) - SLACK, corners.max(axis=0) + SLACK]))
        return self.add_floats(edges)

    def add_ints(self, values: Any) -> int:
        """Append a list and return its start."""
        begin = sum(map(len, self.ints))
        self.ints.append(np.asarray(values, np.int64).ravel())
        return begin

    def begin(self, surface: Surface, boxes: Boxes) -> tuple[list[int], list[float]]:
        """Add the town's part, and return both headers, to be completed and passed to :meth:`end`."""
        head = [0] * kernels.INTS
        heads = [0.0] * kernels.FLOATS
        head[kernels.I_CELLS_X], head[kernels.I_CELLS_Y] = surface.grid.columns, surface.grid.rows
        heads[kernels.F_X], heads[kernels.F_Y] = surface.grid.x, surface.grid.y
        head[kernels.I_ROAD_ROWS] = self.add_ints(surface.starts)
        head[kernels.I_ROAD_LIST] = self.add_ints(surface.listed)
        head[kernels.I_ROAD_EDGES] = self.add_floats(surface.edges)

        head[kernels.I_BOXES] = self.add_floats(boxes.boxes)
        head[kernels.I_BOX_CELLS_X], head[kernels.I_BOX_CELLS_Y] = boxes.grid.columns, boxes.grid.rows
        heads[kernels.F_BOX_X], heads[kernels.F_BOX_Y] = boxes.grid.x, boxes.grid.y
        head[kernels.I_BOX_CELLS] = self.add_ints(boxes.starts)
        head[kernels.I_BOX_LIST] = self.add_ints(boxes.listed)
        return head, heads

    def end(self, head: list[int], heads: list[float]) -> None:
        """Put the headers in front."""
        self.ints[0] = np.array(head, np.int64)
        self.floats[0] = np.array(heads, np.float64)

    def packed(self, cells: NDArray[np.uint8]) -> Packed:
        """Return the arrays, read-only."""
        floats, ints = np.concatenate(self.floats), np.concatenate(self.ints)
        for array in (floats, ints, cells):
            array.setflags(write=False)
        return Packed(floats, ints, cells)


@dataclasses.dataclass(frozen=True)
class Grid:
    """Square cells over a rectangle."""

    x: float
    y: float
    size: float
    columns: int
    rows: int

    @classmethod
    def over(cls, bounds: Sequence[float], size: float) -> Grid:
        """Return a grid on whole multiples of the cells' size, with one spare cell on each side."""
        x, y = math.floor(bounds[0] / size) - 1, math.floor(bounds[1] / size) - 1
        columns, rows = math.ceil(bounds[2] / size) + 1 - x, math.ceil(bounds[3] / size) + 1 - y
        return cls(x * size, y * size, size, columns, rows)

    def part(self, edges: Floats) -> tuple[Grid, tuple[slice, slice]]:
        """Return the part of this grid around some edges, and its slices."""
        low = np.minimum(edges[:, :2], edges[:, 2:]).min(axis=0)
        high = np.maximum(edges[:, :2], edges[:, 2:]).max(axis=0)
        inner = Grid.over((*low.tolist(), *high.tolist()), self.size)
        column, row = round((inner.x - self.x) / self.size), round((inner.y - self.y) / self.size)
        left, right = (min(max(k, 0), self.columns) for k in (column, column + inner.columns))
        bottom, top = (min(max(k, 0), self.rows) for k in (row, row + inner.rows))
        part = Grid(self.x + left * self.size, self.y + bottom * self.size, self.size, right - left, top - bottom)
        return part, (slice(bottom, top), slice(left, right))

    def touched(self, edges: Floats) -> Marks:
        """Return a mask of the cells that an edge touches, (rows, columns)."""
        marks = np.zeros((self.rows, self.columns), np.bool_)
        mark_edges(marks, edges, self.x, self.y, self.size)
        return marks

    def rows_of(self, edges: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """List the edges that meet each row of cells; return where each row's list begins (rows + 1), and the lists."""
        low = np.floor((np.minimum(edges[:, 1], edges[:, 3]) - self.y) / self.size - 1e-6).astype(np.int64)
        high = np.floor((np.maximum(edges[:, 1], edges[:, 3]) - self.y) / self.size + 1e-6).astype(np.int64)
        level = edges[:, 1] == edges[:, 3]  # a ray along x crosses no level edge
        lists = [np.flatnonzero((low <= row) & (row <= high) & ~level) for row in range(self.rows)]
        starts = np.concatenate([[0], np.cumsum([len(one) for one in lists], dtype=np.int64)])
        return starts, np.concatenate([np.empty(0, np.int64), *lists])

    def covered(self, edges: Floats) -> Marks:
        """Return a mask of the cells whose middle lies in a polygon, (rows, columns)."""
        marks = np.zeros((self.rows, self.columns), np.bool_)
        starts, listed = self.rows_of(edges)
        mark_inside(marks, np.ascontiguousarray(edges), starts, listed, self.x, self.y, self.size)
        return marks


@dataclasses.dataclass(frozen=True, eq=False)
class Surface:
    """The road on its grid; all approaches of a town share it."""

    grid: Grid
    edges: Floats
    starts: NDArray[np.int64]
    listed: NDArray[np.int64]
    codes: NDArray[np.uint8]
    """(rows, columns), ROAD_IN, ROAD_EDGE or 0."""

    @classmethod
    def of(cls, road: BaseGeometry) -> Surface:
        """Rasterise a road."""
        grid = Grid.over(road.bounds, kernels.CELL)
        edges = edges_of(road)
        starts, listed = grid.rows_of(edges)
        codes = np.where(grid.covered(edges), kernels.ROAD_IN, 0).astype(np.uint8)
        codes[grid.touched(edges)] = kernels.ROAD_EDGE
        return cls(grid, edges, starts, listed, codes)


@dataclasses.dataclass(frozen=True, eq=False)
class Boxes:
    """The solid boxes on their grid; all approaches of a town share them."""

    grid: Grid
    boxes: Floats
    starts: NDArray[np.int64]
    listed: NDArray[np.int64]

    @classmethod
    def of(cls, solids: Floats) -> Boxes:
        """List each box in the cells from which a car may touch it."""
        boxes = boxes_of(solids)
        margin = REACH + kernels.BOX_CELL / 2
        half_x = np.abs(boxes[:, 2]) * boxes[:, 4] + np.abs(boxes[:, 3]) * boxes[:, 5] + margin
        half_y = np.abs(boxes[:, 3]) * boxes[:, 4] + np.abs(boxes[:, 2]) * boxes[:, 5] + margin
        sides = np.stack([boxes[:, 0] - half_x, boxes[:, 1] - half_y, boxes[:, 0] + half_x, boxes[:, 1] + half_y])
        if not len(boxes):
            return cls(Grid(0.0, 0.0, kernels.BOX_CELL, 0, 0), boxes, np.zeros(1, np.int64), np.empty(0, np.int64))
        bounds = (*sides[:2].min(axis=1).tolist(), *sides[2:].max(axis=1).tolist())
        grid = Grid.over(bounds, kernels.BOX_CELL)
        spans = np.floor((sides - np.array([[grid.x], [grid.y], [grid.x], [grid.y]])) / grid.size).astype(np.int64)
        lists: list[list[int]] = [[] for _ in range(grid.rows * grid.columns)]
        for k, (left, low, right, high) in enumerate(spans.T.tolist()):
            for row in range(low, high + 1):
                for column in range(left, right + 1):
                    lists[row * grid.columns + column].append(k)
        starts = np.concatenate([[0], np.cumsum([len(one) for one in lists])]).astype(np.int64)
        return cls(grid, boxes, starts, np.array([k for one in lists for k in one], np.int64))


def pack(
    surface: Surface,
    boxes: Boxes,
    areas: Sequence[BaseGeometry],
    lanes: Sequence[tuple[BaseGeometry, Floats]],
    approach: Floats,
    exits: Iterable[tuple[Floats, float] | None],
) -> Packed:
    """Pack the geometry of one approach.

    Args:
        surface: the road.
        boxes: the solid boxes.
        areas: junction areas, the trial's own first.
        lanes: polygon and centre line (n, 2) of the lanes around the junction, at most 14.
        approach: the incoming lane's centre line (n, 2).
        exits: centre line and width of the exit lanes LEFT, RIGHT, STRAIGHT; None for an exit that does not exist.

    Raises:
        ValueError: a line has no length, or there are too many lanes.
    """
    packer = Packer()
    head, heads = packer.begin(surface, boxes)
    area_edges = [edges_of(area) for area in areas]
    head[kernels.I_AREAS] = len(areas)
    head[kernels.I_AREA_TABLE] = packer.add_ints([(packer.add_polygon(edges), len(edges)) for edges in area_edges])
    if len(lanes) >= kernels.LANE_EDGE:
        raise ValueError(f"lanes: {len(lanes)} meet at one junction; the judge allows {kernels.LANE_EDGE - 1} at most")
    lane_edges = [edges_of(polygon) for polygon, _ in lanes]
    lane_lines = [segments_of(line) for _, line in lanes]
    head[kernels.I_LANES] = len(lanes)
    head[kernels.I_LANE_TABLE] = packer.add_ints(
        [
            (packer.add_polygon(edges), len(edges), packer.add_floats(line), len(line))
            for edges, line in zip(lane_edges, lane_lines, strict=True)
        ]
    )

    line = segments_of(approach)
    if not len(line):
        raise ValueError("approach: its lane has no length; give at least two different points")
    head[kernels.I_APPROACH], head[kernels.I_APPROACH_COUNT] = packer.add_floats(line), len(line)
    heads[kernels.F_STOP_X], heads[kernels.F_STOP_Y] = approach[-1].tolist()
    heads[kernels.F_STOP_UX], heads[kernels.F_STOP_UY] = line[-1, 2:4].tolist()
    for k, exit_lane in enumerate(exits):
        if exit_lane is not None:
            line = segments_of(exit_lane[0])
            head[kernels.I_EXITS + 2 * k : kernels.I_EXITS + 2 * k + 2] = packer.add_floats(line), len(line)
            heads[kernels.F_WIDTHS + k] = exit_lane[1]

    packer.end(head, heads)
    return packer.packed(_codes(surface, area_edges, lane_edges))


def _codes(surface: Surface, areas: Sequence[Floats], lanes: Sequence[Floats]) -> NDArray[np.uint8]:
    grid = surface.grid
    area = np.zeros((grid.rows, grid.columns), np.uint8)
    lane = np.zeros_like(area)
    for codes, shapes, edge in ((area, areas, kernels.AREA_EDGE), (lane, lanes, kernels.LANE_EDGE)):
        parts = [grid.part(edges) for edges in shapes]
        for k, (edges, (part, where)) in enumerate(zip(shapes, parts, strict=True)):
            number = min(k + 1, kernels.AREA_OTHER) if codes is area else k + 1
            codes[where][part.covered(edges)] = number
        for edges, (part, where) in zip(shapes, parts, strict=True):
            codes[where][part.touched(edges)] = edge
    packed: NDArray[np.uint8] = np.ravel(surface.codes | (area << 2) | (lane << 4))
    return packed


def numbers_of(thresholds: Thresholds) -> Floats:
    """Return the thresholds and the car's body as the kernels read them."""
    vehicle = VEHICLE
    numbers = np.zeros(kernels.NUMBERS)
    radius = math.sqrt(vehicle.half_length**2 + vehicle.half_width**2)
    assert radius <= REACH, "the boxes' grid is made for a smaller car"
    numbers[kernels.N_ENGAGE] = thresholds.engage_distance
    numbers[kernels.N_WRONG_WAY] = thresholds.wrong_way_distance
    numbers[kernels.N_EXIT] = thresholds.exit_distance
    numbers[kernels.N_EXIT_COS] = math.cos(math.radians(thresholds.exit_heading))
    numbers[kernels.N_COMMAND] = thresholds.command_distance
    numbers[kernels.N_TTC] = thresholds.ttc_horizon
    numbers[kernels.N_FRONT_AXLE] = vehicle.wheelbase - vehicle.rear_axle
    numbers[kernels.N_REAR_AXLE] = -vehicle.rear_axle
    numbers[kernels.N_WHEEL_SIDE] = vehicle.half_track
    numbers[kernels.N_HALF_LENGTH] = vehicle.half_length
    numbers[kernels.N_HALF_WIDTH] = vehicle.half_width
    numbers[kernels.N_RADIUS] = radius
    numbers[kernels.N_TIME_LIMIT] = thresholds.time_limit - CLOCK_TOLERANCE
    numbers[kernels.N_WHEELS_OFF] = thresholds.wheels_off
    numbers[kernels.N_STAND_DISTANCE] = thresholds.stand_distance
    numbers[kernels.N_STAND_TIME] = thresholds.stand_time - CLOCK_TOLERANCE
    numbers[kernels.N_REST_DISTANCE] = thresholds.rest_distance
    numbers[kernels.N_REST_TIME] = thresholds.rest_time - CLOCK_TOLERANCE
    numbers[kernels.N_REST_TOTAL] = thresholds.rest_total - CLOCK_TOLERANCE
    numbers[kernels.N_AREA_TOTAL] = thresholds.area_total - CLOCK_TOLERANCE
    numbers[kernels.N_WAIT_DISTANCE] = thresholds.wait_distance
    numbers[kernels.N_WAIT_TIME] = thresholds.wait_time - CLOCK_TOLERANCE
    numbers[kernels.N_LAST_WAIT_TIME] = thresholds.last_wait_time - CLOCK_TOLERANCE
    numbers[kernels.N_OPPOSED_DISTANCE] = thresholds.opposed_distance
    numbers.setflags(write=False)
    return numbers
