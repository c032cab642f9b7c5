"""The compiled arithmetic against the same text interpreted, and against shapely."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from handmade_junction import junction
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shapely import LineString, Point, Polygon, box

from wrongturn_judge import THRESHOLDS, kernels
from wrongturn_judge.packing import Packed, edges_of, numbers_of, segments_of
from wrongturn_protocol import JunctionType
from wrongturn_sim.view.window import box as corners


def _interpreted() -> SimpleNamespace:
    """The kernels as plain Python: the same file without the compiler."""
    text = Path(kernels.__file__).read_text(encoding="utf-8")
    names: dict = {"__name__": "interpreted"}
    text = text.replace("@compiled()", "")
    exec(compile(text, kernels.__file__, "exec"), names)
    return SimpleNamespace(**names)


PLAIN = _interpreted()
QUICK = settings(max_examples=80)
coordinate = st.floats(-30, 30, allow_nan=False)
angle = st.floats(-math.pi, math.pi)
side = st.floats(0.1, 12.0)


@given(x=coordinate, y=coordinate)
@QUICK
def test_a_point_lies_in_a_polygon_with_a_hole(x: float, y: float) -> None:
    shape = Polygon([(-20, -20), (25, -15), (10, 0), (22, 20), (-18, 14)], [[(-5, -5), (4, -3), (0, 6)]])
    point = Point(x, y)
    assume(shape.boundary.distance(point) > 1e-9)
    flat = edges_of(shape).ravel()
    assert kernels.inside(flat, 0, len(flat) // 4, x, y) == shape.contains(point)
    assert kernels.distance_to_edges(flat, 0, len(flat) // 4, x, y) == pytest.approx(shape.boundary.distance(point))


@given(x=coordinate, y=coordinate)
@QUICK
def test_a_point_is_projected_on_a_line(x: float, y: float) -> None:
    points = np.array([(-20.0, -20.0), (-5.0, -18.0), (-5.0, -18.0), (8.0, 3.0), (20.0, 25.0)])
    line, flat = LineString(points), segments_of(points)
    s, distance, ux, uy = kernels.project(flat.ravel(), 0, len(flat), x, y)
    assert distance == pytest.approx(line.distance(Point(x, y)))
    nearest = line.interpolate(s)
    assert nearest.distance(Point(x, y)) == pytest.approx(distance, abs=1e-9)
    assert math.sqrt(ux * ux + uy * uy) == pytest.approx(1.0)


def _box(*place: float) -> Polygon:
    return Polygon(corners(*place))


@given(x=coordinate, y=coordinate, yaw=angle, other=angle, length=side, width=side, vx=coordinate, vy=coordinate)
@QUICK
def test_boxes_meet_when_shapely_says_so(
    x: float, y: float, yaw: float, other: float, length: float, width: float, vx: float, vy: float
) -> None:
    arguments = (
        x, y, vx, vy, math.cos(yaw), math.sin(yaw), 2.3, 0.95,
        math.cos(other), math.sin(other), length / 2, width / 2,
    )  # fmt: skip
    time = kernels.contact(*arguments)
    assert time == PLAIN.contact(*arguments)
    car = _box(0, 0, yaw, 4.6, 1.9)

    def gap(t: float) -> float:
        thing = _box(x + vx * t, y + vy * t, other, length, width)
        return -1.0 if car.intersection(thing).area > 1e-9 else car.distance(thing)

    if time == kernels.OVERLAP:
        assert car.distance(_box(x, y, other, length, width)) == 0.0
    elif math.isinf(time):
        assert all(gap(t) > -0.5 for t in np.linspace(0, 5, 21))
    else:
        assert gap(time) <= 1e-6
        assert all(gap(t) > -0.5 for t in np.linspace(0, time * 0.999, 11))


@given(x=coordinate, y=coordinate, yaw=angle, length=side, width=side)
@QUICK
def test_a_box_meets_a_polygon_when_they_overlap(x: float, y: float, yaw: float, length: float, width: float) -> None:
    shape = Polygon([(-20, -20), (25, -15), (10, 0), (22, 20), (-18, 14)], [[(-9, -9), (8, -8), (0, 9)]])
    thing = _box(x, y, yaw, length, width)
    # Boxes that only touch, or nearly so, are left out.
    assume(thing.buffer(1e-6).intersects(shape) == (thing.intersection(shape).area > 1e-9))
    flat = edges_of(shape).ravel()
    arguments = (0, len(flat) // 4, x, y, math.cos(yaw), math.sin(yaw), length / 2, width / 2)
    assert kernels.box_meets(flat, *arguments) == thing.intersects(shape)
    assert PLAIN.box_meets(flat.tolist(), *arguments) == thing.intersects(shape)


CROSS = junction(other_areas=[box(-4, 40, 4, 50)])
SOLID = junction(
    JunctionType.LEFT_RIGHT,
    solids=[(0, 8, 0.1, 20, 0.5), (8, -12, 1.0, 5, 4), (-9, -15, 0.0, 0.6, 0.6), (30, 7, 0, 12, 8)],
)
NUMBERS = numbers_of(THRESHOLDS).view(kernels.NUMBERS)[0]


def ground_of(packed: Packed) -> kernels.Ground:
    return kernels.Ground(packed.head.view(kernels.HEAD), packed.floats, packed.ints, packed.cells)


GROUND = {True: ground_of(SOLID.packed), False: ground_of(CROSS.packed)}


@given(x=st.floats(-90, 90), y=st.floats(-90, 90))
@settings(max_examples=150)
def test_the_grid_tells_road_area_and_lane_as_shapely_does(x: float, y: float) -> None:
    point = Point(x, y)
    areas = [CROSS.area, *CROSS.other_areas]
    shapes = [CROSS.road, *areas, *(lane.polygon for lane in CROSS.lanes)]
    assume(all(shape.boundary.distance(point) > 1e-9 for shape in shapes))
    road, area, lane = kernels.surface(GROUND[False], x, y)
    assert road == CROSS.road.contains(point)
    here = [k for k, shape in enumerate(areas) if shape.contains(point)]
    assert area == (0 if not here else kernels.AREA_OWN if here[0] == 0 else kernels.AREA_OTHER)
    lanes = [k for k, strip in enumerate(CROSS.lanes) if strip.polygon.contains(point)]
    assert lane == (lanes[0] + 1 if lanes and not here else 0)


@given(
    x=st.floats(-40, 40),
    y=st.floats(-40, 40),
    yaw=angle,
    v=st.floats(0, 22),
    entered=st.booleans(),
    users=st.lists(st.tuples(coordinate, coordinate, angle, side, side, st.floats(0, 20)), max_size=3),
    solid=st.booleans(),
)
@settings(max_examples=120)
def test_compiled_and_interpreted_looks_are_the_same_bit_for_bit(
    x: float, y: float, yaw: float, v: float, entered: bool, users: list, solid: bool
) -> None:
    arguments = GROUND[solid], NUMBERS, np.array(users, np.float64).reshape(-1, 6), x, y, yaw, v, entered
    compiled = kernels.inspect_row(*arguments)
    with np.errstate(over="ignore"):  # compiled code says nothing of a quotient that is too large
        plain = PLAIN.inspect_row(*arguments)
    assert compiled == (int(plain[0]), *map(float, plain[1:]))


@given(x=st.floats(-40, 40), y=st.floats(-40, 40), yaw=angle, v=st.floats(0, 22))
@settings(max_examples=150)
def test_no_box_on_the_way_is_missed(x: float, y: float, yaw: float, v: float) -> None:
    c, s = math.cos(yaw), math.sin(yaw)
    found = kernels.contact_with_solids(GROUND[True], NUMBERS, x, y, c, s, v)
    times = [
        kernels.contact(
            bx - x, by - y, -v * c, -v * s, c, s, 2.3, 0.95, math.cos(t), math.sin(t), length / 2, width / 2
        )
        for bx, by, t, length, width in SOLID.solids.tolist()
    ]
    least = min(times)
    assert found == pytest.approx(least if least <= 5.0 else math.inf)
