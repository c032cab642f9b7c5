"""What an evaluation on a suite of journeys came to, as CoRL 2017 (Dosovitskiy et al.) counts it."""

from wrongturn_protocol.episodes import Message
from wrongturn_protocol.vocabulary import Condition, Task


class Infractions(Message):
    """How often it went wrong for each kilometre driven."""

    off_road: float
    """The car left the road: its centre, or three or more wheels."""
    wrong_lane: float
    """Its centre came into an oncoming lane."""
    collisions: float
    """A journey ends with the first."""


class NavigationCount(Message):
    """Journeys that reached their goal, of a fixed number."""

    episodes: int
    success: int
    """Ended in ``arrived``: the goal was reached within the time that the shortest way takes at 10 km/h."""
    clean: int
    """Of these, without any infraction."""
    rate: float
    """Of success."""
    ci95: tuple[float, float]
    """Wilson's interval of that rate."""
    completion: float
    """Mean share of the shortest way that was covered, 0 to 1."""
    distance: float
    """Driven in all, kilometres."""
    per_km: Infractions | None
    """None where nothing was driven."""


class NavigationMetrics(Message):
    """Success by task and condition."""

    total: NavigationCount
    """Over all of the suite's trials."""
    table: dict[Task, dict[Condition, NavigationCount]]
    """By task and condition, of those that the suite has."""
