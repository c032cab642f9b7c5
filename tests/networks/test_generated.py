"""Generated towns: every seed makes one, with junctions of all types, and equal seeds make equal towns."""

from collections import Counter
from pathlib import Path

import pytest

from wrongturn_networks import read_town
from wrongturn_networks.making import Recipe, build
from wrongturn_networks.making.generated import generated_recipe
from wrongturn_networks.making.recipes import RECIPES
from wrongturn_protocol import JunctionType


def _arms(recipe: Recipe) -> Counter[str]:
    return Counter(end for street in recipe.streets for end in (street.start, street.end))


def test_every_seed_makes_a_town_of_its_own() -> None:
    recipes = [generated_recipe(seed) for seed in range(100)]
    for recipe in recipes:
        arms = _arms(recipe)
        assert set(arms) == set(recipe.nodes)
        assert set(arms.values()) <= {3, 4}
        ends = [frozenset((street.start, street.end)) for street in recipe.streets]
        assert len(set(ends)) == len(ends)
        assert all(len(pair) == 2 for pair in ends)
        assert recipe.name not in RECIPES
    assert len({tuple(sorted(recipe.nodes.values())) for recipe in recipes}) == len(recipes)
    assert recipes[:9] == [generated_recipe(seed) for seed in range(9)]
    with pytest.raises(ValueError, match="seed: is -1"):
        generated_recipe(-1)


def test_towns_are_built_with_all_types(tmp_path: Path) -> None:
    recipe = generated_recipe(1)
    build(recipe, tmp_path / recipe.name)
    town = read_town(tmp_path / recipe.name)
    assert len(town.approaches) == sum(_arms(recipe).values())
    assert town.scenery
    assert set(town.summary().approaches) == set(JunctionType)
