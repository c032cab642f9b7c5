"""What the pictures show, and where."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import contains_xy

from wrongturn_protocol import SegmentationClass, Weather
from wrongturn_sim.camera import Camera, Renderer, World, look_of, render_batch

ROADLIKE = (SegmentationClass.ROAD, SegmentationClass.LANE_MARKING)


def ground_points(camera, x, y, yaw, away=60.0):
    """Rows, columns and ground points of the pixels that look at the ground no farther away than this."""
    eye_x = x + camera.forward * math.cos(yaw) - camera.left * math.sin(yaw)
    eye_y = y + camera.forward * math.sin(yaw) + camera.left * math.cos(yaw)
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    b = (camera.cy - v) / camera.focal
    on = math.cos(camera.pitch) + b * math.sin(camera.pitch)
    rise = b * math.cos(camera.pitch) - math.sin(camera.pitch)
    aside = (camera.cx - u) / camera.focal
    with np.errstate(divide="ignore"):
        t = np.where(rise < -1e-6, -camera.up / rise, np.inf)
    seen = t < away
    v, u, t, on, aside = v[seen], u[seen], t[seen], on[seen], aside[seen]
    look = yaw + camera.yaw
    cos, sin = math.cos(look), math.sin(look)
    return v, u, eye_x + t * (on * cos - aside * sin), eye_y + t * (on * sin + aside * cos)


@settings(max_examples=12)
@given(
    pick=st.integers(0, 6),
    distance=st.floats(-5, 40),
    lean=st.floats(-0.8, 0.8),
    aside=st.floats(-1.5, 1.5),
    tilted=st.booleans(),
)
def test_ground_is_what_the_town_says(town, bare, before, pick, distance, lean, aside, tilted):
    approach = list(town.approaches.values())[pick]
    x, y, yaw = before(approach, distance)
    x, y, yaw = x - aside * math.sin(yaw), y + aside * math.cos(yaw), yaw + lean
    camera = Camera(pitch=0.1, yaw=0.2, up=1.9, left=0.3) if tilted else Camera()
    _, segmentation = Renderer(bare, camera).render(x, y, yaw)
    rows, columns, xs, ys = ground_points(camera, x, y, yaw)
    seen = segmentation[rows, columns]
    # Away from edges: 0.15 m, a cell and its diagonal.
    for inside, outside, classes in (
        (town.road.buffer(-0.15), town.road.buffer(0.15), ROADLIKE),
        (town.sidewalks.buffer(-0.15), town.sidewalks.buffer(0.15), (SegmentationClass.SIDEWALK,)),
    ):
        within = contains_xy(inside, xs, ys)
        if within.any():
            assert np.isin(seen[within], classes).mean() >= 0.99
        without = ~contains_xy(outside, xs, ys)
        if without.any():
            assert np.isin(seen[without], classes).mean() <= 0.01
    assert not np.isin(segmentation, (5, 6, 7, 8)).any()


def test_no_markings_inside_junctions(town, bare):
    camera = Camera(height=128, cy=5.0, up=20.0, pitch=0.9)
    for junction in town.junctions.values():
        x, y = junction.position
        for yaw in (0.0, 1.5, 3.0, 4.5):
            _, segmentation = Renderer(bare, camera).render(x - 12 * math.cos(yaw), y - 12 * math.sin(yaw), yaw)
            rows, columns, xs, ys = ground_points(camera, x - 12 * math.cos(yaw), y - 12 * math.sin(yaw), yaw)
            within = contains_xy(junction.area, xs, ys)
            assert within.sum() > 1000
            assert not (segmentation[rows, columns][within] == SegmentationClass.LANE_MARKING).any()


def test_lanes_are_marked_on_both_sides(town, bare, before):
    for approach in town.approaches.values():
        _, segmentation = Renderer(bare).render(*before(approach, 15.0))
        row = segmentation[44] == SegmentationClass.LANE_MARKING
        assert row[:96].any()
        assert row[96:].any()


def car_ahead(x, y, yaw, distance, kind=0, size=(4.5, 1.8, 1.5), colour=1):
    return np.array(
        [[x + distance * math.cos(yaw), y + distance * math.sin(yaw), yaw, *size, kind, colour]], np.float64
    )


@pytest.mark.parametrize("distance", [10.0, 20.0, 35.0])
def test_a_car_covers_the_rows_that_it_should(bare, distance):
    _, segmentation = Renderer(bare).render(-60.0, 0.0, 0.0, 0, car_ahead(-60.0, 0.0, 0.0, distance))
    rows, columns = np.nonzero(segmentation == SegmentationClass.VEHICLE)
    back = distance - 0.7 - 2.25
    assert rows.max() == pytest.approx(26.0 + 107.4 * 1.6 / back, abs=1.5)
    # The roof, behind the sloping rear window, is the highest that is seen.
    assert 26.0 + 107.4 * 0.1 / (distance - 0.7 + 2.25) - 1 <= rows.min() <= 26.0 + 107.4 * 0.1 / back + 1.5
    assert columns.min() == pytest.approx(96.0 - 107.4 * 0.9 / back, abs=1.5)
    assert columns.max() == pytest.approx(96.0 + 107.4 * 0.9 / back, abs=1.5)


def test_a_pedestrian_covers_the_rows_that_it_should(bare):
    others = car_ahead(-60.0, 0.0, 0.0, 10.7, kind=1, size=(0.5, 0.5, 1.75))
    rgb, segmentation = Renderer(bare).render(-60.0, 0.0, 0.0, 0, others)
    rows, columns = np.nonzero(segmentation == SegmentationClass.PEDESTRIAN)
    assert rows.min() == pytest.approx(26.0 - 107.4 * 0.15 / 10.0, abs=1.5)
    assert rows.max() == pytest.approx(26.0 + 107.4 * 1.6 / 10.0, abs=1.5)
    assert 3 <= np.ptp(columns) <= 8
    other, _ = Renderer(bare).render(-60.0, 0.0, 0.0, 0, others + np.eye(8)[7])
    assert (rgb != other).any()


def test_nothing_is_seen_through_a_house(town, world):
    """A car right behind a house changes no pixel."""
    for house in [item for item in town.scenery if item.kind == "house"][:8]:
        away = np.array([house.x, house.y]) / max(math.hypot(house.x, house.y), 1.0)
        x, y = np.array([house.x, house.y]) - 25 * away
        yaw = math.atan2(away[1], away[0])
        renderer = Renderer(world)
        _, alone = renderer.render(x, y, yaw)
        far = np.array([house.x, house.y]) + away * (math.hypot(house.length, house.width) / 2 + 1.0)
        _, behind = renderer.render(x, y, yaw, 0, np.array([[*far, yaw, 1.0, 1.0, 1.2, 0, 0]]))
        if alone[26, 96] == SegmentationClass.BUILDING:
            assert not (behind == SegmentationClass.VEHICLE).any()


def test_the_nearer_of_two_cars_hides_the_other(bare):
    near, far = car_ahead(-60.0, 0.0, 0.0, 10.0), car_ahead(-60.0, 0.0, 0.0, 20.0, colour=7)
    alone = Renderer(bare).render(-60.0, 0.0, 0.0, 0, near)
    for both in (np.concatenate([near, far]), np.concatenate([far, near])):
        pictures = Renderer(bare).render(-60.0, 0.0, 0.0, 0, both)
        hidden = alone[1] == SegmentationClass.VEHICLE
        assert np.array_equal(pictures[0][hidden], alone[0][hidden])


def test_scenery_stands_where_it_stands(town, world):
    """The foot of each solid, seen from 15 m before its long side, is where the formula says."""
    camera = Camera()
    checked = 0
    for item in town.scenery:
        if item.kind not in {"house", "wall"}:
            continue
        side = np.array([-math.sin(item.yaw), math.cos(item.yaw)])
        x, y = np.array([item.x, item.y]) - side * (item.width / 2 + 15.0)
        yaw = math.atan2(side[1], side[0])
        alone = World(world.ground, world.frame, world.scenery[[town.scenery.index(item)]])
        _, segmentation = Renderer(alone, camera).render(x, y, yaw)
        corners = np.array([[-item.length / 2, 0.0], [item.length / 2, 0.0]])
        front = np.array([item.x, item.y]) - side * item.width / 2
        along = np.array([math.cos(item.yaw), math.sin(item.yaw)])
        points = np.array([[*(front + along * corner[0]), 0.0] for corner in corners])
        pixels = camera.project(points, x, y, yaw)
        rows, columns = np.nonzero(np.isin(segmentation, (5, 6)))
        assert rows.max() == pytest.approx(pixels[:, 1].max(), abs=1.0)
        assert columns.min() == pytest.approx(max(pixels[:, 0].min(), 0), abs=1.0)
        assert columns.max() == pytest.approx(min(pixels[:, 0].max(), 191), abs=1.0)
        checked += 1
    assert checked > 10


@pytest.mark.parametrize("weather", list(Weather))
def test_every_pixel_is_painted(world, town, before, weather):
    """No pixel has class void or keeps what was there before."""
    for approach in list(town.approaches.values())[:3]:
        pose = before(approach, 12.0)
        pictures = []
        for fill in (0, 255):
            rgb, segmentation = np.full((64, 192, 3), fill, np.uint8), np.full((64, 192), fill, np.uint8)
            looks, poses = look_of(weather)[None], np.array([pose])
            render_batch(world, Camera(), looks, [0], poses, [0], rgb[None], segmentation[None])
            pictures.append((rgb, segmentation))
        assert np.array_equal(pictures[0][0], pictures[1][0])
        assert np.array_equal(pictures[0][1], pictures[1][1])
        assert segmentation.min() >= 1
        assert segmentation.max() <= 10


def test_a_pitch_of_almost_nothing_changes_almost_nothing(world, town, before):
    """Pitched cameras are painted in another way, which must agree with that for level ones."""
    pose = before(next(iter(town.approaches.values())), 20.0)
    level = Renderer(world).render(*pose)[1]
    tilted = Renderer(world, Camera(pitch=1e-9)).render(*pose)[1]
    assert (level != tilted).mean() < 0.002


@pytest.mark.parametrize(("up", "pitch"), [(2.5, 0.15), (12.0, 0.35), (30.0, 0.8), (60.0, 1.5)])
def test_what_is_lower_than_the_camera_shows_its_top(bare, town, before, up, pitch):
    x, y, yaw = before(next(iter(town.approaches.values())), 30)
    cars = np.array(
        [[x + on * math.cos(yaw), y + on * math.sin(yaw), yaw, 4.5, 1.8, 1.5, 0, 1] for on in (-15, -6, 0.5, 8, 16)]
    )
    camera = Camera(256, 192, 120.0, 128.0, 96.0, 0.0, 0.0, up, pitch)
    _, segmentation = Renderer(bare, camera).render(x, y, yaw, others=cars)
    # The middle of the roof: the cabin sits a little behind the middle of the car.
    u, v = camera.project(np.column_stack([cars[:, :2], np.full(len(cars), 1.49)]), x, y, yaw).T
    inside = (u >= 0) & (u < 255) & (v >= 0) & (v < 191)
    assert inside.sum() == (5 if pitch == 1.5 else inside.sum()) >= 1
    assert (
        segmentation[v[inside].round().astype(int), u[inside].round().astype(int)] == SegmentationClass.VEHICLE
    ).all()


def test_trees_are_seen_from_above(world, bare, town):
    x, y, yaw = (*next(iter(town.junctions.values())).position, 0.0)
    camera = Camera(256, 256, 150.0, 128.0, 128.0, 0.0, 0.0, 90.0, 1.5)
    pictures = [Renderer(kind, camera).render(x, y, yaw)[0].astype(int) for kind in (world, bare)]
    crowns = [(tree.x, tree.y, tree.height - 0.1) for tree in town.scenery if tree.kind == "tree"]
    u, v = camera.project(np.array(crowns), x, y, yaw).T
    inside = (u >= 0) & (u < 255) & (v >= 0) & (v < 255)
    columns, rows = u[inside].round().astype(int), v[inside].round().astype(int)
    assert len(rows) > 2
    assert (pictures[0][rows, columns] != pictures[1][rows, columns]).any(axis=-1).all()
