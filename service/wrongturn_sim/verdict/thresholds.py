"""The published numbers of the verdict. A change to any of them is a change of scoring: bump ``version``."""

from __future__ import annotations

import dataclasses
import math


@dataclasses.dataclass(frozen=True)
class Thresholds:
    """What the judge compares with; ``docs/verdicts.md`` shows the same table, and a test compares the two.

    Every field can be swept with :func:`dataclasses.replace`; a swept one never makes a published verdict.

    Raises:
        ValueError: a number is not finite, or not positive, or an angle or count is out of its range.
    """

    version: int = 1
    """Of these numbers and of the definitions that use them."""
    stop_speed: float = 0.3
    """A car slower than this stands, m/s."""
    stop_time: float = 3.0
    """Standing for this long without interruption in one zone is a stop, s."""
    time_limit: float = 40.0
    """An episode's time, s."""
    engage_distance: float = 15.0
    """A car whose centre came this near to the stop line, along the approach's lane, is engaged, m."""
    wheels_off: int = 3
    """So many wheels off the road are off the road; fewer are a kerb bite."""
    wrong_way_distance: float = 20.0
    """Farther from the junction's area than this without an exit is a wrong way, m."""
    exit_distance: float = 10.0
    """The rear bumper must be this far past the exit line, along the exit's lane, m."""
    exit_heading: float = 30.0
    """The car's heading may differ from the exit lane's by this much, degrees."""
    command_distance: float = 5.0
    """A command counts for an exit while the centre is at most this far past its exit line, m."""
    obeyed_distance: float = 15.0
    """Leaving the road to one side is obeying from this far before the stop line on, m."""
    obeyed_lateral: float = 6.0
    """Leaving the road straight ahead is obeying within this distance of the approach street's axis, m."""
    ttc_horizon: float = 5.0
    """Contacts farther ahead than this are none, s."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{field.name}: {value} is not a positive, finite number")
        if not 1 <= self.wheels_off <= 4:
            raise ValueError(f"wheels_off: {self.wheels_off} is not a number of wheels from 1 to 4")
        if self.exit_heading > 180:
            raise ValueError(f"exit_heading: {self.exit_heading} degrees are more than 180")


THRESHOLDS = Thresholds()
"""The published ones."""
