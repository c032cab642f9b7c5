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
from wrongturn_judge.compiling import compiled, words
from wrongturn_judge.kernels import Array
from wrongturn_judge.thresholds import JOURNEY_THRESHOLDS, THRESHOLDS, JourneyThresholds, Thresholds
from wrongturn_protocol import VEHICLE, Vehicle

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

    head: Floats
    """A row of :data:`~wrongturn_judge.kernels.HEAD`."""
    floats: Floats
    ints: NDArray[np.int64]
    cells: NDArray[np.uint8]

    @property
    def arrays(self) -> tuple[Floats, Floats, NDArray[np.int64], NDArray[np.uint8]]:
        """The first arguments of the judges' ``observe``."""
        return self.head, self.floats, self.ints, self.cells


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
    """Collects floats and ints, with the road first; its methods return where each added list begins."""

    def __init__(self, surface: Surface) -> None:
        self._floats: list[Floats] = []
        self._ints: list[NDArray[np.int64]] = []
        self._row = np.zeros(words(kernels.HEAD))
        self.head: Any = self._row.view(kernels.HEAD)[0]
        """What is added, for the caller to fill in."""
        head = self.head
        head.cells_x, head.cells_y = surface.grid.columns, surface.grid.rows
        head.x, head.y = surface.grid.x, surface.grid.y
        head.road_rows, head.road_list = self.add_ints(surface.starts), self.add_ints(surface.listed)
        head.road_edges = self.add_floats(surface.edges)

    def add_floats(self, values: Any) -> int:
        """Append a list and return its start."""
        begin = sum(map(len, self._floats))
        self._floats.append(np.ascontiguousarray(values, np.float64).ravel())
        return begin

    def add_ints(self, values: Any) -> int:
        """Append a list and return its start."""
        begin = sum(map(len, self._ints))
        self._ints.append(np.asarray(values, np.int64).ravel())
        return begin

    def add_polygon(self, edges: Floats) -> tuple[int, int]:
        """Append slightly widened bounds, then the edges; return the edges' start and number."""
        corners = edges.reshape(-1, 2) if len(edges) else np.zeros((1, 2))
        self.add_floats(np.concatenate([corners.min(axis=0) - SLACK, corners.max(axis=0) + SLACK]))
        return self.add_floats(edges), len(edges)

    def add_areas(self, areas: Sequence[Floats]) -> None:
        """Append junction areas, each given by its edges."""
        self.head.areas = len(areas)
        self.head.area_table = self.add_ints([self.add_polygon(edges) for edges in areas])

    def add_lanes(self, lanes: Iterable[tuple[Floats, Floats]]) -> None:
        """Append lanes, each given by its edges and its centre line (n, 2)."""
        table = []
        for edges, centreline in lanes:
            line = segments_of(centreline)
            table.append((*self.add_polygon(edges), self.add_floats(line), len(line)))
        self.head.lanes, self.head.lane_table = len(table), self.add_ints(table)

    def packed(self, cells: NDArray[Any]) -> Packed:
        """Return the arrays, read-only, without any boxes."""
        return _frozen(self._row, np.concatenate(self._floats), np.concatenate(self._ints), np.ravel(cells))


def with_boxes(packed: Packed, boxes: Boxes) -> Packed:
    """Return a geometry that was packed without boxes, and these appended; the cells are shared."""
    row = packed.head.copy()
    head: Any = row.view(kernels.HEAD)[0]
    head.boxes = len(packed.floats)
    head.box_cells_x, head.box_cells_y = boxes.grid.columns, boxes.grid.rows
    head.box_x, head.box_y = boxes.grid.x, boxes.grid.y
    head.box_cells = len(packed.ints)
    head.box_list = head.box_cells + len(boxes.starts)
    floats = np.concatenate([packed.floats, boxes.boxes.ravel()])
    return _frozen(row, floats, np.concatenate([packed.ints, boxes.starts, boxes.listed]), packed.cells)


def _frozen(*arrays: Any) -> Packed:
    for array in arrays:
        array.setflags(write=False)
    return Packed(*arrays)


@compiled()
def mark_edges(marks: Array, edges: Array, x: float, y: float, size: float) -> None:
    """Mark every cell of ``marks`` (rows, columns) that an edge of ``edges`` (n, 4) touches."""
    slack = 1e-6
    rows, columns = marks.shape
    for k in range(edges.shape[0]):
        x1, y1, x2, y2 = edges[k, 0] - x, edges[k, 1] - y, edges[k, 2] - x, edges[k, 3] - y
        left = max(math.floor((min(x1, x2) - slack) / size), 0)
        right = min(math.floor((max(x1, x2) + slack) / size), columns - 1)
        low = max(math.floor((min(y1, y2) - slack) / size), 0)
        high = min(math.floor((max(y1, y2) + slack) / size), rows - 1)
        nx, ny = y1 - y2, x2 - x1
        reach = (abs(nx) + abs(ny)) * (size / 2 + slack)
        for row in range(low, high + 1):
            for column in range(left, right + 1):
                mx = (column + 0.5) * size - x1
                my = (row + 0.5) * size - y1
                if abs(mx * nx + my * ny) <= reach:
                    marks[row, column] = True


@compiled()
def mark_inside(marks: Array, edges: Array, starts: Array, listed: Array, x: float, y: float, size: float) -> None:
    """Mark every cell whose middle lies in a polygon; ``starts`` and ``listed`` are those of ``Grid.rows_of``."""
    rows, columns = marks.shape
    flat = edges.ravel()
    for row in range(rows):
        for column in range(columns):
            marks[row, column] = kernels.inside_listed(
                flat, 0, listed, starts[row], starts[row + 1], x + (column + 0.5) * size, y + (row + 0.5) * size
            )


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
    areas: Sequence[BaseGeometry],
    lanes: Sequence[tuple[BaseGeometry, Floats]],
    approach: Floats,
    approach_width: float,
    exits: Iterable[tuple[Floats, float] | None],
) -> Packed:
    """Pack the geometry of one approach, whose lane has the centre line ``approach`` (n, 2), without boxes.

    ``areas`` are the junctions', the trial's own first. ``lanes`` are polygons and centre lines (n, 2) of those around
    the junction, at most 14. ``exits`` are centre line and width of the exit lanes LEFT, RIGHT, STRAIGHT; None for one
    that does not exist. Raises ValueError if a line has no length, or there are too many lanes.
    """
    packer = Packer(surface)
    area_edges = [edges_of(area) for area in areas]
    packer.add_areas(area_edges)
    if len(lanes) >= kernels.LANE_EDGE:
        raise ValueError(f"lanes: {len(lanes)} meet at one junction; the judge allows {kernels.LANE_EDGE - 1} at most")
    lane_edges = [edges_of(polygon) for polygon, _ in lanes]
    packer.add_lanes(zip(lane_edges, (line for _, line in lanes), strict=True))

    head, line = packer.head, segments_of(approach)
    if not len(line):
        raise ValueError("approach: its lane has no length; give at least two different points")
    head.approach, head.approach_count = packer.add_floats(line), len(line)
    head.stop_x, head.stop_y = approach[-1].tolist()
    head.stop_ux, head.stop_uy = line[-1, 2:4].tolist()
    known = [(np.empty((0, 6)), 0.0) if one is None else (segments_of(one[0]), one[1]) for one in exits]
    head.exits = packer.add_ints([(packer.add_floats(line), len(line)) for line, _ in known])
    head.widths = packer.add_floats([*(width for _, width in known), approach_width])

    area, lane = np.zeros_like(surface.codes), np.zeros_like(surface.codes)
    for codes, shapes, edge in ((area, area_edges, kernels.AREA_EDGE), (lane, lane_edges, kernels.LANE_EDGE)):
        parts = [surface.grid.part(edges) for edges in shapes]
        for k, (edges, (part, where)) in enumerate(zip(shapes, parts, strict=True)):
            codes[where][part.covered(edges)] = min(k + 1, kernels.AREA_OTHER) if codes is area else k + 1
        for edges, (part, where) in zip(shapes, parts, strict=True):
            codes[where][part.touched(edges)] = edge
    return packer.packed(surface.codes | (area << 2) | (lane << 4))


def numbers_of(
    thresholds: Thresholds = THRESHOLDS, limits: JourneyThresholds = JOURNEY_THRESHOLDS, car: Vehicle = VEHICLE
) -> Floats:
    """Return thresholds and the car's body as the kernels read them: a row of NUMBERS."""
    values = dataclasses.asdict(thresholds)
    values |= {f"journey_{name}": value for name, value in dataclasses.asdict(limits).items()}
    for name in values:
        if name.endswith(("_time", "_total", "time_limit")):
            values[name] -= CLOCK_TOLERANCE
    values["exit_cos"] = math.cos(math.radians(thresholds.exit_heading))
    values["across_cos"] = math.cos(math.radians(thresholds.across_heading))
    values["turn_limit"] = math.radians(thresholds.turn_limit)
    values["speed_limit"] = thresholds.speed_limit / 3.6
    values["front_axle"], values["rear_axle"] = car.wheelbase - car.rear_axle, -car.rear_axle
    values["wheel_side"] = car.half_track
    values["half_length"], values["half_width"] = car.half_length, car.half_width
    values["radius"] = math.sqrt(car.half_length**2 + car.half_width**2)
    assert values["radius"] <= REACH, "the boxes' grid is made for a smaller car"
    numbers = np.array([values[name] for name in kernels.NUMBERS.names or ()], np.float64)
    numbers.setflags(write=False)
    return numbers
