"""The car's dimensions and limits, and how often it is steered."""

import math
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Vehicle:
    """The car's dimensions and limits, in metres, seconds and radians."""

    wheelbase: float = 2.9
    length: float = 4.6
    width: float = 1.9
    rear_axle: float = 1.45
    """Distance from the rear axle forward to the body's centre."""
    half_track: float = 0.8
    """Distance from the axis to the wheels on either side."""
    max_wheel_angle: float = math.radians(35.0)
    """Angle of the front wheels at steering 1."""
    steering_slew: float = 2.0
    """Greatest change of the steering (-1..1) per second."""
    acceleration: float = 3.5
    """Acceleration at full throttle, m/s²."""
    braking: float = 8.0
    """Deceleration at full brake, m/s²; any brake overrides the throttle."""
    drag: float = 0.15
    """Drag of a moving car, m/s²."""
    drag_speed: float = 0.01
    """Additional drag in proportion to the speed, 1/s."""
    grip: float = 7.0
    """Greatest lateral acceleration, m/s²: beyond it the car runs wide."""
    max_speed: float = 22.0
    """Top speed, m/s; there is no reverse."""

    @property
    def half_length(self) -> float:
        """Distance from the centre to either bumper."""
        return self.length / 2

    @property
    def half_width(self) -> float:
        """Distance from the axis to either side."""
        return self.width / 2


VEHICLE: Final = Vehicle()
DECISION_S: Final = 0.1
"""Time between two decisions of an agent whose rig names no rate, seconds."""
"""The benchmark's car."""
