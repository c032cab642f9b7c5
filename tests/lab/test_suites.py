from lab import suites
from wrongturn_networks import suite_ids


def test_every_shipped_suite_is_what_its_recipe_gives():
    assert set(suites.RECIPES) == set(suite_ids())
    assert suites.differing() == []
