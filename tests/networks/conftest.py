"""What the networks' tests share."""

import pytest

from wrongturn_networks import Town, load_town, town_names


@pytest.fixture(params=town_names())
def town(request: pytest.FixtureRequest) -> Town:
    """Each shipped town in turn."""
    return load_town(request.param)
