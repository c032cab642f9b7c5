"""Tests of the objects beside the road."""

import dataclasses
import math
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import STRtree

from wrongturn_networks import CorruptFileError, SceneryKind, SceneryObject, Town, load_town
from wrongturn_networks.making.placing import place_scenery
from wrongturn_networks.scenery import read_scenery, scenery_toml


def test_nothing_stands_on_road_or_sidewalk(town: Town) -> None:
    for ground in (town.road, town.sidewalks):
        assert all(item.footprint().distance(ground) >= 0.3 for item in town.scenery)


def test_nothing_stands_in_anything_else(town: Town) -> None:
    footprints = [item.footprint() for item in town.scenery]
    tree = STRtree(footprints)
    pairs = tree.query(footprints, predicate="intersects").T
    assert [(a, b) for a, b in pairs if a != b] == []


def test_houses_walls_trunks_and_hedges_are_solid(town: Town) -> None:
    for item in town.scenery:
        assert item.solid is (item.kind is not SceneryKind.FENCE)
        assert (item.crown_radius > 0) is (item.kind is SceneryKind.TREE)
        assert min(item.length, item.width, item.height) > 0
        assert item.kind is not SceneryKind.TREE or item.length < 1
        assert abs(item.yaw) <= math.pi + 1e-4  # written with four decimals


@given(st.integers(0, 2**53 - 1))
@settings(max_examples=10)
def test_a_seed_draws_scenery_that_stands_where_it_may(seed: int) -> None:
    town = load_town("junctions")
    placed = place_scenery(town, seed)
    assert placed == place_scenery(town, seed)
    assert {*placed}.isdisjoint(place_scenery(town, seed + 1))
    drawn = dataclasses.replace(town, scenery=placed)
    test_nothing_stands_on_road_or_sidewalk(drawn)
    test_nothing_stands_in_anything_else(drawn)


def test_scenery_comes_back_as_it_was_written(tmp_path: Path) -> None:
    objects = (
        SceneryObject(SceneryKind.HOUSE, 1.25, -3.5, 0.7854, 12.0, 8.0, 6.5, solid=True, seed=7),
        SceneryObject(SceneryKind.TREE, 0.0, 0.0, 0.0, 0.4, 0.4, 5.0, solid=True, seed=8, crown_radius=1.5),
    )
    path = tmp_path / "scenery.toml"
    path.write_text(scenery_toml(objects), "utf-8")
    assert read_scenery(path) == objects


@pytest.mark.parametrize(
    "text", ["[[object]]\nkind = 'castle'", "[[object]]\nkind = 'house'", "object = 3", "not toml"]
)
def test_scenery_that_is_none(text: str, tmp_path: Path) -> None:
    path = tmp_path / "scenery.toml"
    path.write_text(text, "utf-8")
    with pytest.raises(CorruptFileError, match=r"scenery\.toml"):
        read_scenery(path)
