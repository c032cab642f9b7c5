"""Results of an evaluation on a suite of journeys, counted as in CoRL 2017 (Dosovitskiy et al.)."""

from wrongturn_protocol.episodes import Message
from wrongturn_protocol.vocabulary import Condition, Task


class Infractions(Message):
    """Infractions for each kilometre driven."""

    off_road: float
    """Times the car left the road with its centre, or with three or more wheels."""
    wrong_lane: float
    """Times the car's centre entered an oncoming lane."""
    collisions: float
    """Collisions; a journey ends with the first."""


class NavigationCount(Message):
    """Journeys that reached their goal, out of all."""

    episodes: int
    success: int
    """Journeys with the verdict ``arrived``: the goal was reached in time."""
    clean: int
    """Successful journeys without any infraction."""
    rate: float
    """Share of successful journeys."""
    ci95: tuple[float, float]
    """Wilson's 95% interval of ``rate``."""
    completion: float
    """Mean share of the shortest way that was covered, 0 to 1."""
    distance: float
    """Kilometres driven in all."""
    per_km: Infractions | None
    """Infractions for each kilometre; None if nothing was driven."""


class NavigationMetrics(Message):
    """Success by task and condition."""

    total: NavigationCount
    """Count over all trials of the suite."""
    table: dict[Task, dict[Condition, NavigationCount]]
    """Counts by the tasks and conditions of the suite."""
