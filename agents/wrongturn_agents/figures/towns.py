"""Towns, over whose roads trajectories are drawn."""

from collections.abc import Callable
from functools import lru_cache

from wrongturn_agents.errors import ResultsError
from wrongturn_client import Client
from wrongturn_client.plugins import LOADERS, entry_points, load
from wrongturn_protocol import TownDetail

FindTown = Callable[[str], TownDetail]
"""Returns a town by its name."""


@lru_cache(maxsize=32)
def installed_town(name: str) -> TownDetail:
    """Return a town that is installed here.

    Raises:
        ResultsError: wrongturn-networks is not installed, or has no such town.
    """
    point = entry_points(LOADERS).get("town")
    if point is None:
        raise ResultsError("no towns are installed here; install wrongturn-networks (again)")
    try:
        found: TownDetail = load(point)(name).detail({})
    except ValueError as error:
        raise ResultsError(str(error)) from error
    return found


def town_of(url: str) -> FindTown:
    """Return a function that gets towns from a service, each once."""

    @lru_cache(maxsize=32)
    def find(name: str) -> TownDetail:
        with Client(url, "", patience=0) as client:
            return client.town(name)

    return find
