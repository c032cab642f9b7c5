"""The published thresholds of verdicts. Changing one changes scores: make a new version of the suites."""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar, Final


@dataclasses.dataclass(frozen=True)
class Thresholds:
    """Thresholds of the verdict. ``docs/verdicts.md`` has the same table, and a test compares the two.

    To try other values, use :func:`dataclasses.replace`; published verdicts never use them. Journeys use only some.
    Raises ValueError if a number is not finite or not positive, or an angle or count is out of range.
    """

    version: ClassVar[int] = 3
    """Version of the definitions that use these numbers."""
    time_limit: float = 60.0
    """Time of an episode, s."""
    engage_distance: float = 15.0
    """A car is engaged once its centre is this near to the stop line, along the approach's lane, m."""
    wheels_off: float = 3
    """A car with this many wheels off the road is off the road; fewer are a kerb bite."""
    wrong_way_distance: float = 20.0
    """A car farther from the junction's area than this, without an exit, went a wrong way, m."""
    exit_distance: float = 10.0
    """The rear bumper must be this far past the exit line, along the exit's lane, m."""
    exit_heading: float = 30.0
    """The car's heading may differ from the exit lane's by this much, degrees."""
    watch_distance: float = 25.0
    """After an exit a drive is watched only as far as this before the next stop line, m."""
    ahead_time: float = 1.0
    """When a watched drive ends, the car must stay on the road for this long, with its steering or straight on, s."""
    command_distance: float = 5.0
    """A command counts for an exit while the centre is at most this far past its exit line, m."""
    obeyed_distance: float = 15.0
    """Leaving the road to one side is obeying from this far before the stop line on, m."""
    obeyed_lateral: float = 6.0
    """Leaving the road straight ahead is obeying within this distance of the approach street's axis, m."""
    ttc_horizon: float = 5.0
    """Contacts farther in the future than this are ignored, s."""
    stand_distance: float = 0.3
    """A car that moved less than this in ``stand_time`` stands, m."""
    stand_time: float = 3.0
    """The time in which a standing car moved less than ``stand_distance``, s."""
    rest_distance: float = 0.1
    """A car that moved less than this in ``rest_time`` is at rest, m."""
    rest_time: float = 1.0
    """The time in which a car at rest moved less than ``rest_distance``, s."""
    rest_total: float = 5.0
    """A car that was at rest over the junction area for this long, all in all, has stopped there, s."""
    area_total: float = 20.0
    """A car that was over the junction area for this long, all in all, has stopped there, s."""
    turn_limit: float = 180.0
    """A car that turned by more than this over the junction area, left and right added up, went a wrong way,
    degrees."""
    wait_distance: float = 0.5
    """A car that moved less than this in ``wait_time`` before the junction has stopped there, m."""
    wait_time: float = 10.0
    """The time in which a car that stops before the junction moved less than ``wait_distance``, s."""
    last_wait_time: float = 3.0
    """The same when the episode's time runs out, s."""
    opposed_distance: float = 10.0
    """Driving farther than this on opposed lanes, all in all, is the flag ``opposed_lane``, m. So is ending on one."""

    across_heading: float = 45.0
    """A stopped car whose heading differs from its lane's by more than this stands across it, degrees."""
    speed_limit: float = 50.0
    """A car that was ever faster than this has the flag ``speeding``, km/h."""
    kerb_distance: float = 20.0
    """Driving farther than this with a wheel off the road, all in all, is the flag ``kerb_ride``, m."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{field.name}: {value} is not a positive, finite number")
        if not 1 <= self.wheels_off <= 4:
            raise ValueError(f"wheels_off: {self.wheels_off} is not a number of wheels from 1 to 4")
        for name, angle in (("exit_heading", self.exit_heading), ("across_heading", self.across_heading)):
            if angle > 180:
                raise ValueError(f"{name}: {angle} degrees are more than 180")


@dataclasses.dataclass(frozen=True)
class JourneyThresholds:
    """Thresholds of journeys besides those of every verdict; only training uses those of ``strict``."""

    stop_speed: float = 0.3
    """Strict: a slower car stands, m/s."""
    wrong_way_time: float = 1.0
    """Strict: the drive ends when the centre was in an oncoming lane for this long without interruption, s."""
    stand_time: float = 5.0
    """Strict: the drive ends when the car stood for this long without interruption, s."""
    back_time: float = 1.0
    """A car that leaves its road or lane is counted again after it was back for this long, s."""


THRESHOLDS: Final = Thresholds()
"""The published thresholds."""
JOURNEY_THRESHOLDS: Final = JourneyThresholds()
"""The published thresholds of journeys."""
