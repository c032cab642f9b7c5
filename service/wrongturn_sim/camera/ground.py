"""The ground of a town as a raster: its kinds, its tones and its shadows.

Each cell is one byte, its code. Bits 0 to 3 are the tone, bits 4 and 5 the kind (vegetation, road, marking, sidewalk).
Bits 6 and 7 are set where the ground lies in the shade of the first and the second sun of
:mod:`~wrongturn_sim.camera.weathers`.

:func:`bare` makes what depends on the net alone, and :func:`dressed` adds feet and shadows of scenery, which is quick.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from shapely import LineString
from shapely.geometry.base import BaseGeometry
from shapely.ops import substring

from wrongturn_networks import Lane, SceneryKind, SceneryObject, Town
from wrongturn_sim.camera.noise import tile
from wrongturn_sim.camera.solids import crown_of
from wrongturn_sim.camera.weathers import SUNS

CELL: Final = 0.125
"""Side of a cell, metres."""
MARGIN: Final = 24.0
"""Metres of raster around road and sidewalks. Beyond it there is grass."""
VEGETATION, ROAD, MARKING, SIDEWALK = range(4)

LINE_WIDTH: Final = 0.2
"""Metres; the next two as well."""
DASH: Final = 3.0
GAP: Final = 3.0
SOLID_NEAR_JUNCTION: Final = 20.0
"""Metres before and after a junction where the centre line is solid."""
EDGE_OFFSET: Final = 0.3
"""Metres from the kerb to the middle of the edge line."""

_SHIFT: Final = 8

Raster = NDArray[np.uint8]


def _grown(mask: Raster, cells: int) -> Raster:
    """Return a mask widened by this many cells on every side, or narrowed if the number is below 0."""
    size = 2 * abs(cells) + 1
    change: Any = cv2.dilate if cells > 0 else cv2.erode
    grown: Raster = change(mask, np.ones((size, size), np.uint8))
    return grown


@dataclass(frozen=True)
class Grid:
    """The cells of a raster: the corner of the first one, metres, and their number."""

    x: float
    y: float
    rows: int
    columns: int

    @classmethod
    def around(cls, bounds: tuple[float, float, float, float]) -> "Grid":
        """Return the grid that covers the bounds and the margin."""
        x, y = (math.floor(bounds[0] - MARGIN), math.floor(bounds[1] - MARGIN))
        columns, rows = (math.ceil((bounds[2 + i] + MARGIN - (x, y)[i]) / CELL) for i in (0, 1))
        return cls(float(x), float(y), rows, columns)

    def fixed(self, points: Any) -> NDArray[np.int32]:
        """Return points (N, 2), metres, as cells in OpenCV's fixed-point coordinates."""
        cells = np.asarray(points, np.float64)[:, :2] - (self.x, self.y)
        cells *= (1 << _SHIFT) / CELL
        cells -= 0.5 * (1 << _SHIFT)
        return np.rint(cells, out=cells).astype(np.int32)

    def mask(self) -> Raster:
        """Return an empty mask."""
        return np.zeros((self.rows, self.columns), np.uint8)

    def fill(self, into: Raster, geometry: BaseGeometry) -> None:
        """Set the cells of polygons to 1."""
        # OpenCV fills a polygon's outline too, so take half a cell off. A corner that collapses divides by zero, which
        # does no harm.
        with np.errstate(all="ignore"):
            narrowed = geometry.buffer(-CELL / 2, join_style="mitre")
        for part in _polygons(narrowed):
            rings = [self.fixed(ring.coords) for ring in (part.exterior, *part.interiors)]
            cv2.fillPoly(into, rings, 1, shift=_SHIFT)


def _polygons(geometry: BaseGeometry) -> Iterator[Any]:
    for part in getattr(geometry, "geoms", [geometry]):
        if part.geom_type == "Polygon" and not part.is_empty:
            yield part


def _strip(line: BaseGeometry, width: float = LINE_WIDTH) -> BaseGeometry:
    return line.buffer(width / 2, cap_style="flat", join_style="mitre")


def centre_lines(lanes: Any) -> Iterator[BaseGeometry]:
    """Yield the lines between two directions: dashed, and solid near junctions."""
    for lane in lanes:
        if lane.opposite is None or lane.id > lane.opposite:
            continue
        line = LineString(lane.centreline).offset_curve(lane.axis)
        length = line.length
        first = min(SOLID_NEAR_JUNCTION, length) if lane.start_junction else 0.0
        last = max(length - SOLID_NEAR_JUNCTION, first) if lane.end_junction else length
        if first > 0.0:
            yield _strip(substring(line, 0.0, first))
        if last < length:
            yield _strip(substring(line, last, length))
        begin = first + GAP
        while begin + DASH / 2 < last:
            yield _strip(substring(line, begin, min(begin + DASH, last)))
            begin += DASH + GAP


def edge_line(lane: Lane) -> BaseGeometry:
    """Return the line along the kerb."""
    side = math.copysign(1.0, lane.axis)
    return _strip(LineString(lane.centreline).offset_curve(side * (EDGE_OFFSET - lane.kerb)))


_CORNERS: Final = np.array([(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)])


def _foot(item: SceneryObject, wider: float = 0.0) -> NDArray[np.float64]:
    """Return the corners of an object's box, (4, 2), each side moved outwards by so many metres."""
    cos, sin = math.cos(item.yaw), math.sin(item.yaw)
    along, across = item.length + 2 * wider, item.width + 2 * wider
    turned: NDArray[np.float64] = _CORNERS @ np.array([(along * cos, along * sin), (-across * sin, across * cos)])
    turned += item.x, item.y
    return turned


def _shadow(
    grid: Grid, into: Raster, item: SceneryObject, foot: NDArray[np.float64], sun: tuple[float, float], bit: int
) -> None:
    elevation, bearing = sun
    reach = 1.0 / math.tan(elevation)
    away = np.array([-math.cos(bearing), -math.sin(bearing)]) * reach
    if item.kind is SceneryKind.TREE:
        radius, middle, half = crown_of(item)
        centre = np.array([item.x, item.y]) + away * middle
        # The shadow of an ellipsoid is as wide as the ellipsoid, and longer along the light.
        long = math.sqrt(radius**2 + (half * reach) ** 2)
        turn = np.linspace(0.0, 2 * math.pi, 20, endpoint=False)
        ragged = 1.0 + 0.12 * np.sin(turn * 5 + item.seed % 7)
        along, aside = long * ragged * np.cos(turn), radius * ragged * np.sin(turn)
        unit = away / reach
        points = centre + along[:, None] * unit + aside[:, None] * np.array([-unit[1], unit[0]])
        cv2.fillPoly(into, [grid.fixed(points)], bit, shift=_SHIFT)
        root = np.array([[item.x, item.y], *(np.array([[item.x, item.y]]) + away * middle)])
        cv2.polylines(into, [grid.fixed(root)], False, bit, 3, shift=_SHIFT)
        return
    if item.kind is SceneryKind.FENCE:
        for share in (0.35, 0.7, 0.95):
            rail = foot + away * item.height * share
            cv2.polylines(into, [grid.fixed(rail)], True, bit, 1, shift=_SHIFT)
        return
    points = np.concatenate([foot, foot + away * item.height])
    hull = cv2.convexHull(grid.fixed(points))
    cv2.fillConvexPoly(into, hull, bit, shift=_SHIFT)


def bare(town: Town) -> tuple[Grid, Raster]:
    """Return a town's grid and its ground without scenery, (rows, columns): kind times 32, plus tone, 0 to 18."""
    grid = Grid.around(town.bounds)
    road, walk, marking, crossing = (grid.mask() for _ in range(4))
    grid.fill(road, town.road)
    grid.fill(walk, town.sidewalks)
    cars = list(town.lanes.values())
    for strip in (*centre_lines(cars), *(edge_line(lane) for lane in cars)):
        grid.fill(marking, strip)
    for junction in town.junctions.values():
        grid.fill(crossing, junction.area.buffer(CELL))
    walk &= 1 - road
    marking &= road & (1 - crossing)
    # Close seams between road and sidewalk that are narrower than a cell, or grass would show in them.
    both = road | walk
    closed = _grown(_grown(both, 1), -1)
    walk |= closed & (1 - both)

    kind = grid.mask()
    kind[walk > 0] = SIDEWALK
    kind[road > 0] = ROAD
    kind[marking > 0] = MARKING
    tones = np.clip(_tones(town, grid, kind, road, walk), 0, _BRIGHTEST).astype(np.uint8)
    tones |= kind << 5
    return grid, tones


def dressed(grid: Grid, ground: Raster, scenery: Iterable[SceneryObject]) -> Raster:
    """Return the codes of a ground with scenery, (rows, columns): darker at its feet, and in its shade."""
    feet, shades = grid.mask(), [grid.mask() for _ in SUNS]
    for item in scenery:
        wider = 0.25 if item.kind is SceneryKind.FENCE else 0.6
        # OpenCV fills a polygon's outline too, so take half a cell off.
        cv2.fillPoly(feet, [grid.fixed(_foot(item, wider - CELL / 2))], 1, shift=_SHIFT)
        foot = _foot(item)
        for number, (shade, sun) in enumerate(zip(shades, SUNS, strict=True)):
            _shadow(grid, shade, item, foot, sun, 64 << number)
    code = np.asarray(cv2.LUT(ground, _CODES[0]), np.uint8)
    cv2.copyTo(cv2.LUT(ground, _CODES[1]), feet, code)
    for shade in shades:
        cv2.bitwise_or(code, shade, code)
    return code


def _code(cell: int, darker: int) -> int:
    return cell >> 5 << 4 | min(max((cell & 31) - darker, 0), 15)


_BRIGHTEST: Final = 18
_CODES: Final = [np.array([_code(cell & 127, darker) for cell in range(256)], np.uint8) for darker in (0, 3)]
"""Codes of a cell of the bare ground, and of one at the foot of scenery."""


def _tones(town: Town, grid: Grid, kind: Raster, road: Raster, walk: Raster) -> NDArray[np.int16]:
    """Return the tones: worn asphalt and markings, slabs, kerbs, tufts."""
    grain = _spread(tile(512, (1,), 11), grid).astype(np.int16)
    patch = _spread(tile(512, (32, 16, 8), 12), grid).astype(np.int16)
    blotch = _spread(tile(512, (128, 64), 13), grid).astype(np.int16)
    tones = (grain * 3 + patch * 6 + blotch * 6) >> 8  # vegetation, 0 to 14

    asphalt = 2 + ((grain * 2 + patch * 3 + blotch * 4) >> 8)
    gutter = road & (1 - _grown(road, -2))
    asphalt[gutter > 0] -= 2
    cracks = (np.abs(patch - 128) < 2) & (blotch > 150)
    asphalt[cracks] -= 3
    for cell, size, bright in _mends(town, grid):
        asphalt[cell[1] : cell[1] + size[1], cell[0] : cell[0] + size[0]] += bright
    np.copyto(tones, asphalt, where=kind == ROAD)

    worn = 4 + ((patch * 4 - grain) >> 8)
    np.clip(worn, 0, 7, out=worn)
    # Lines far from every kerb lie between two directions: they are yellow.
    inner = _grown(road, -8)
    worn += 8 * (inner > 0)
    np.copyto(tones, worn, where=kind == MARKING)

    slabs = 5 + ((grain * 3 + patch * 3 + blotch * 2) >> 8)
    period = round(1.5 / CELL)
    rows, columns = np.arange(grid.rows) % period == 0, np.arange(grid.columns) % period == 0
    slabs[rows, :] -= 3
    slabs[:, columns] -= 3
    kerb = _grown(road, 2) & walk
    slabs[kerb > 0] = 13 + ((grain[kerb > 0] * 2) >> 8)
    back = walk & _grown(1 - road - walk, 1)
    slabs[back > 0] -= 3
    np.copyto(tones, slabs, where=kind == SIDEWALK)
    return tones


def _mends(town: Town, grid: Grid) -> Iterator[tuple[tuple[int, int], tuple[int, int], int]]:
    """Yield mended places of the asphalt: first cell, size, and how much brighter they are."""
    draw = np.random.default_rng(int(town.plain.sha256[:8], 16))
    for lane in town.lanes.values():
        line = LineString(lane.centreline)
        for _ in range(int(line.length / 18.0)):
            point = line.interpolate(float(draw.random()), normalized=True)
            size = draw.integers(6, 22, 2)
            cell = (
                int((point.x + draw.uniform(-1.2, 1.2) - grid.x) / CELL),
                int((point.y + draw.uniform(-1.2, 1.2) - grid.y) / CELL),
            )
            yield cell, (int(size[0]), int(size[1])), -2 if draw.random() < 0.7 else 2


def _spread(pattern: Raster, grid: Grid) -> Raster:
    size = pattern.shape[0]
    return np.tile(pattern, (-(-grid.rows // size), -(-grid.columns // size)))[: grid.rows, : grid.columns]
