"""Generated towns: every seed makes one, with junctions of all types, and equal seeds make equal towns."""

from collections import Counter
from pathlib import Path

import pytest

from wrongturn_networks import read_town
from wrongturn_networks.making.generated import generated_recipe
from wrongturn_networks.making.recipes import RECIPES, Recipe
from wrongturn_protocol import JunctionType

SEEDS = range(200)


def _arms(recipe: Recipe) -> Counter[str]:
    return Counter(end for street in recipe.streets for end in (street.start, street.end))


@pytest.mark.parametrize("seed", SEEDS)
def test_every_junction_has_three_or_four_arms(seed: int) -> None:
    recipe = generated_recipe(seed)
    arms = _arms(recipe)
    assert set(arms) == set(recipe.nodes)
    assert set(arms.values()) <= {3, 4}


@pytest.mark.parametrize("seed", SEEDS)
def test_no_two_streets_join_the_same_junctions(seed: int) -> None:
    ends = [frozenset((street.start, street.end)) for street in generated_recipe(seed).streets]
    assert len(set(ends)) == len(ends)
    assert all(len(pair) == 2 for pair in ends)


def test_seeds_draw_different_towns_and_each_the_same_again() -> None:
    recipes = [generated_recipe(seed) for seed in SEEDS]
    assert len({tuple(sorted(recipe.nodes.values())) for recipe in recipes}) == len(SEEDS)
    assert recipes == [generated_recipe(seed) for seed in SEEDS]


def test_a_generated_town_is_none_that_is_shipped() -> None:
    assert not {generated_recipe(seed).name for seed in SEEDS} & set(RECIPES)


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(ValueError, match="seed: is -1"):
        generated_recipe(-1)


def test_towns_are_built_with_all_types(tmp_path: Path) -> None:
    pytest.importorskip("sumo", reason="needs netconvert")
    from wrongturn_networks.making.netconvert import build

    found: Counter[JunctionType] = Counter()
    for seed in (0, 1):
        recipe = generated_recipe(seed)
        build(recipe, tmp_path / recipe.name)
        town = read_town(tmp_path / recipe.name)
        assert len(town.approaches) == sum(_arms(recipe).values())
        assert town.scenery
        found += town.summary().approaches
    assert set(found) == set(JunctionType)
